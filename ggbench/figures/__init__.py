"""Figures, drawn from arrays and from what a results folder holds; each function returns one."""
