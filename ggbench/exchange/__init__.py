"""Files of problems and estimates, for filters in any language."""

PROGRAM = "exec:"
"""Prefix of texts that name a program as an estimator."""
