"""Simulators behind one interface of torch tensors."""

from .building import build_physics

__all__ = ["build_physics"]
