"""Contents of scenario files, as pydantic models."""
