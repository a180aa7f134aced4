"""Compiled estimators on blocks of runs, and what several estimators are made of."""
