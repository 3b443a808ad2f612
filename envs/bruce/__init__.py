"""BRUCE: a humanoid with closed-chain legs, and the gaits that it may follow."""
