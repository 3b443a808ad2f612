"""BRUCE: a humanoid with closed-chain legs that walks as it is told, in many manners."""

from .task import Bruce

__all__ = ["Bruce"]
