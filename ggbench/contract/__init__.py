"""Contract of all estimators: demands, and test problems with known answers.

``ggbench check`` and the tests of the shipped estimators use the same functions.
"""
