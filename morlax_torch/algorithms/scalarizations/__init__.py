"""How a trade-off turns several objectives into one: weighted sums, Chebyshev, or a user's own."""
