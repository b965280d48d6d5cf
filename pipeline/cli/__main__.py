"""``python -m salpcc.pipeline.cli``."""

from salpcc.pipeline.cli.app import main

main()
