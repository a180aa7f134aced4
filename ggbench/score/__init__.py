"""Scores: runs of an estimator in the standard suite, compared with stored runs."""
