"""Speed of the engines compared with other estimation packages, on one problem.

``make bench`` writes the measurements to reports/speed/*.csv, and the page reports/speed.md from
these files. ``make bench-check`` compares speed ratios with their floors. ``python -m speed`` needs
benchmarks/ and tests/ in the module search path. The modules ``problem_file``, ``numpy_model``,
``worker`` and ``rival_*``, except ``rival_ggbench``, also run without ggbench.
"""
