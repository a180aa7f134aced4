"""Compiled arithmetic for batches of runs: kernels, matrix algebra, rotations, source hashes."""
