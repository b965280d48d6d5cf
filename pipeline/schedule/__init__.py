"""How work is done: the shard store, pools and clusters of workers, one run per output, what one scan may break."""
