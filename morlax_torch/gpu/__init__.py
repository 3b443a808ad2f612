"""GPU execution: recorded graphs, fused kernels, a flat optimizer."""
