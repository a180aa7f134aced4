"""A report as one page to share: a single HTML file that needs nothing beside it."""
