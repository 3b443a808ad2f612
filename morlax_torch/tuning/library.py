"""Optuna, or a sentence that says how to install it."""

from ..envs import MorlaxError
from ..envs.errors import installation

try:
    import optuna
except ImportError as error:
    raise MorlaxError(
        f"tuning needs {error.name}, which is not installed: {installation('tune')}."
    ) from None

__all__ = ["optuna"]
