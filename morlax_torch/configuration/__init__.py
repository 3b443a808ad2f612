"""The config of a run: its sections, its files and its trade-offs."""
