"""BRUCE: a humanoid with closed-chain legs, six objectives and a velocity command."""
