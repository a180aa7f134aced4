"""What a reader sees: the text and the figures of reports."""
