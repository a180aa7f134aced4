"""Simulation of a case: problem, truth and bound from a seed."""
