"""Off-policy learning of a whole front."""
