"""What goes into a run: scans cut into groups, files beside them, what their logs hold, digests, what an output holds already."""
