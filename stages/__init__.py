"""The six reversible stages, in order: ingest, segment, ground_fit, predict, residual_code, evaluate."""
