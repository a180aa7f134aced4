"""Files: atomic writing and hashes, safe reading of packed files and of netCDF files."""
