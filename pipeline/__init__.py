"""Who runs the stages: command line, Dask graph, shard store, progress."""
