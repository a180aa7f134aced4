"""Estimators of the benchmark, one file each; :mod:`ggbench.problem` defines the interface."""
