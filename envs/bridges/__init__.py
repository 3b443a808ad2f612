"""Worlds of Gymnasium, mjlab, Playground and vectorized environments."""
