"""Evaluate: decode, measure, compare, report."""
