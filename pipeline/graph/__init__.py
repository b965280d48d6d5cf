"""The graph of a run: stages of groups as tasks, what happens once per sequence, and in which order."""
