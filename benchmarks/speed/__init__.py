"""The speed of the engines compared with other estimation packages, on one problem.

``make bench`` measures into reports/speed/*.csv and writes reports/speed.md from these files;
``make bench-check`` guards the ratios. Run as ``python -m speed`` with benchmarks/ in the path. The
modules ``problem_file``, ``numpy_model``, ``worker`` and ``rival_*`` also run without ggbench.
"""
