"""How good an estimator is: its runs of the standard suite against stored runs of the others."""
