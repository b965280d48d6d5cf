"""From what was recorded to report.json, tables and the page."""
