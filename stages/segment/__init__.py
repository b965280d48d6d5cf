"""Segment: label each return, decide what the task keeps and how finely."""
