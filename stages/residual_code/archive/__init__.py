"""Archives: MCAP files of payloads. ``format`` mirrors schemas/ARCHIVE.md; writer, reader, and what saves broken ones."""
