"""What flows through the pipeline: records, Arrow schemas, configuration, and the archive format."""
