"""Robots on film: drawn, captioned, and written as files."""
