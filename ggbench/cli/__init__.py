"""Command-line interface ``ggbench``."""
