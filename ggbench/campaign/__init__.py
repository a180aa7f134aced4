"""Campaigns: lists of runs, and their execution in processes or on a cluster."""
