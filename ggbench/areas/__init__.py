"""Where to match: what a map's cells hold for a navigator, before anything has flown over them."""
