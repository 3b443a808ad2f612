"""Training runs: the loop, the folder, checkpoints, and loading policies from them."""

from .loading import find_checkpoint, find_run, load, save
from .run import Run

__all__ = ["Run", "find_checkpoint", "find_run", "load", "save"]
