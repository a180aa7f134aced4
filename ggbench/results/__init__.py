"""Results folders of campaigns."""
