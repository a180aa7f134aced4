"""Figures drawn from arrays or from results folders."""
