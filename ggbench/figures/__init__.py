"""Figures of arrays and of results folders; each function returns a figure."""
