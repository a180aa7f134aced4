"""Estimators of other packages on problems of ggbench: one module for each package.

Each converts a :class:`~ggbench.problem.Problem` to the models of its package, and the posterior to
an :class:`~ggbench.problem.Estimate`. The package is an optional dependency.
"""
