"""Study: indices of matching suitability as predictors of flight errors.

``make matching`` flies over 128 cells of two regions and writes reports/matching_area.md. The study
compares errors and fixes with indices of :mod:`ggbench.matchability` and with the error bound of
each flight.

``python -m matching_area`` needs studies/ in the module search path. With ``--report`` it only
rewrites the page, from reports/matching_area/tracks.csv.
"""
