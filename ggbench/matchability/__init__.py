"""Matching suitability of the cells of a map, before any flight."""
