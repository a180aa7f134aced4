"""Compiled estimators for blocks of runs, and components that they share."""
