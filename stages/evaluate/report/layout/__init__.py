"""Layout: figures become tables, plots, pictures and a page."""
