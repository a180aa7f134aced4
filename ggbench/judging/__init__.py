"""How good estimates are: errors of runs, statistics over them, comparisons."""
