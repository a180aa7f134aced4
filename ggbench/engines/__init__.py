"""Compiled estimators on blocks of runs, and their common components."""
