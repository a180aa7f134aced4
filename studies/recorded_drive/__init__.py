"""Study: drift of a recorded INS during GNSS outages, and its predicted covariance."""
