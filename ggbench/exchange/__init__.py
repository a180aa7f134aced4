"""Files of problems and estimates, for filters in any language."""

PROGRAM = "exec:"
"""How the texts begin that name a program as an estimator."""
