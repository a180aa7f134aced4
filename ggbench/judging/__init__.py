"""Judgement of estimates: errors of runs, statistics, comparisons."""
