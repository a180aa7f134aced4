"""Study: measured surveys of ggbench, from a published archive."""
