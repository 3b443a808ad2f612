"""PD-MORL: one conditioned policy, whose values are turned towards its trade-off."""
