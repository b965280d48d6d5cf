"""Which sensor a log is of: fitted, or chosen among the shipped models."""
