"""Worlds that other libraries step, behind the interface of ours."""
