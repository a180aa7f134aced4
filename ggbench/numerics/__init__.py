"""Compiled arithmetic: kernels, vectors and matrices of runs, rotations, source hashes."""
