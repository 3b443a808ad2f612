"""Interfaces to other RL libraries, one file per library."""
