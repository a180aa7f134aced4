"""Figures of arrays and of results folders."""
