"""BRUCE: a humanoid with closed-chain legs, six objectives and a velocity command."""

from .task import Bruce

__all__ = ["Bruce"]
