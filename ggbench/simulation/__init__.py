"""Simulation of cases: problems, truth and Cramér–Rao bounds."""
