"""What every estimator owes, whatever it is: demands, and problems with known answers to ask by.

``ggbench check`` and the tests of the benchmark's own estimators ask by the same functions.
"""
