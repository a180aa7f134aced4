"""Compiled arithmetic: kernels, runs as vectors, their matrices, rotations; the source's hash."""
