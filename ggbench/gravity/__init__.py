"""Gravity field and its gradient: normal field, harmonics, gridded maps, terrain masses."""
