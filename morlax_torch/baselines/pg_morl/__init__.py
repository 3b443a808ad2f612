"""PG-MORL: a population of policies, trained where a model predicts the best front."""
