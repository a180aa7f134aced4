"""Evaluation of estimates: errors of runs, statistics, comparisons."""
