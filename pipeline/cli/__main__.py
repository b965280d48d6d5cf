"""``python -m salpcc.pipeline.cli``."""

from salpcc.pipeline.cli.app import main

if __name__ == "__main__":
    main()
