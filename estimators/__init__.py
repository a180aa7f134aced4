"""The estimators of the benchmark, one file each; see :mod:`ggbench.problem` for the interface."""
