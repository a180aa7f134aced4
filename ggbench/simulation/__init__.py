"""From a scenario's case and a seed to a problem and its truth, with the bound of its error."""
