"""Worlds as a learner sees them: observations, vector rewards, episodes and resets."""
