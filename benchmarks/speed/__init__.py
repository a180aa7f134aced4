"""The speed of the benchmark's engines beside other estimation packages, on one problem.

``make bench`` measures and writes reports/speed.md, ``make bench-check`` guards the ratio of the
engines. Run as ``python -m speed`` with benchmarks/ in the path. The modules ``problem_file``,
``numpy_model``, ``worker`` and ``rival_*`` run in environments without ggbench, too.
"""
