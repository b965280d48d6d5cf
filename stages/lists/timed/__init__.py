"""Points whose lasers and times their message tells, on the rays of lasers that turn steadily."""
