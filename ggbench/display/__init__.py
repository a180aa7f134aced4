"""Progress, tables and times for the terminal and for Python."""
