"""Scores of estimators: runs in the standard suite, compared with stored runs of others."""
