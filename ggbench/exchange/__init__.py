"""Problems and estimates as files, for filters in any language."""
