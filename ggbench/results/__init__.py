"""What campaigns leave behind: a folder of records."""
