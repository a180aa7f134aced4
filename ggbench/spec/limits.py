"""Limits of numbers in scenario files, command options and stored results."""

SCENARIO_NAME = r"^[^/\\\x00]*[^/\\\x00.]$"
"""Pattern of a scenario's name, which is part of names of files and folders."""
MOST_RUNS = 1_000_000
"""Most runs of a case."""
MOST_SEED = 2**63 - 1
"""Largest seed: the largest 64-bit integer."""
LOWEST_M, HIGHEST_M = -11_000.0, 100_000.0
"""Heights of a flight above the ellipsoid [m]: from the deepest sea to the edge of space."""
FASTEST_MPS = 8000.0
"""Largest speed of a flight [m/s], about that of an orbit."""
