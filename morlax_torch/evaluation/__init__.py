"""Pareto fronts: how to evaluate policies, measure fronts and draw them."""
