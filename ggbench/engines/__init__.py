"""Compiled estimators on blocks of runs."""
