"""Viewers: a live page in the browser, and films."""
