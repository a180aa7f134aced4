"""What the command and Python show while they compile and run: progress, tables, times."""
