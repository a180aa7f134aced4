"""Other packages' estimators on this package's problems: one module for each package.

Each gives a :class:`~ggbench.problem.Problem` as the models of its package, and that package's
posterior as an :class:`~ggbench.problem.Estimate`. The package itself is an optional dependency.
"""
