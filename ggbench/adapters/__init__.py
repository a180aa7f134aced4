"""Adapters that run other packages' estimators on ggbench problems, one module per package.

Each module converts a :class:`~ggbench.problem.Problem` to the package's models, and the posterior
to an :class:`~ggbench.problem.Estimate`. The packages are optional dependencies.
"""
