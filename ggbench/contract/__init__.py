"""Contract that all estimators must fulfil: requirements, and test problems with known solutions.

``ggbench check`` and the tests of the shipped estimators use these functions.
"""
