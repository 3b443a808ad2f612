"""Policies as files of other formats."""
