"""The command ``ggbench``."""
