"""Pareto fronts: how to evaluate policies, measure fronts and draw them."""

from .evaluator import Evaluator, Protocol
from .front import Front

__all__ = ["Evaluator", "Front", "Protocol"]
