"""The measured surveys that ggbench ships, made from the published archive."""
