"""Worlds of Gymnasium, mjlab and vectorized environments."""
