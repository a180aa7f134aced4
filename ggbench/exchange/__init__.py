"""Problems and estimates as files, for filters in any language."""

PROGRAM = "exec:"
"""How the texts begin that name a program as an estimator."""
