"""Contract of all estimators: demands, and test problems with known answers.

``ggbench check`` and the tests of the benchmark's own estimators ask by the same functions.
"""
