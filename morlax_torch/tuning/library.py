"""Optuna, or a sentence that says how to install it."""

from ..envs import MorlaxError

try:
    import optuna
except ImportError as error:
    raise MorlaxError(
        f"tuning needs {error.name}, which is not installed: pip install 'morlax-torch[tune]'."
    ) from None

__all__ = ["optuna"]
