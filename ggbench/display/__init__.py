"""Display of progress, tables and times in terminals and notebooks."""
