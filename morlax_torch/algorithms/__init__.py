"""Learners: what they have in common, and MORLAX."""
