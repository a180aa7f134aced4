"""Whether what is said of an area before a flight tells how well the flight will match there.

``make areas`` flies over many cells of two regions, compares errors and locks with every index of
:mod:`ggbench.areas` and with the bound of the flight, and writes reports/matching_area.md. Run as
``python -m matching_area`` with tests/ in the path; ``--report`` writes the report anew from
reports/matching_area/tracks.csv.
"""
