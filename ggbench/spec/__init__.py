"""Pydantic models of the content of scenario files."""
