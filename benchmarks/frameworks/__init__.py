"""Comparison of estimation frameworks on one flight.

The comparison covers results, time, memory, size of the installation and behaviour with bad input.
"""
