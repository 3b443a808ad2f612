"""Hypernetworks, the policies and critics they generate, and normalizers."""
