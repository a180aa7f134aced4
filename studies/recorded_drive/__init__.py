"""Study: drift of a recorded INS during GNSS outages, against its predicted covariance."""
