"""Maps of the gravity gradient: from shipped data or a user's own, and as files."""
