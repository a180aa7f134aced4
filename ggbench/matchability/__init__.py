"""Matching suitability of map cells, without simulated flights."""
