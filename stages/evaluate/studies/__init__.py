"""Studies beside the runs, each a command of its own: races, ablations, lossless coders; reports show what they record."""
