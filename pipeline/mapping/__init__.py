"""Maps and localisation from archives, on the scheduler and the shard store of runs."""
