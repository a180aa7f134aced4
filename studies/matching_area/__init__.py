"""Study: indices of matching suitability as predictors of flight errors.

``make matching`` flies over many cells of two regions, compares errors and fixes with every index
of :mod:`ggbench.matchability` and with the bound of the flight, and writes
reports/matching_area.md. Run as ``python -m matching_area`` with studies/ in the path;
``--report`` writes the page again from reports/matching_area/tracks.csv.
"""
