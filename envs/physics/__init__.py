"""Simulators behind one interface of torch tensors."""
