"""Results of campaigns: folders of records."""
