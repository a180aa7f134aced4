"""Recorded flights: reading, writing of simulated runs, corrected tracks."""
