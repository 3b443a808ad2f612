"""Searches by NSGA-II: for bodies, and for trade-offs that change over time."""
