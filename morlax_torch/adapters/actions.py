"""Check the actions that a user passes to N worlds."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Size, Tensor

from ..envs import MorlaxError


def checked_actions(actions: Tensor | NDArray, shape: Size, place: torch.device) -> Tensor:
    """Check the type, shape and device of actions; their values are not checked.

    Arrays are converted if the worlds are on the CPU. On a GPU, every step would copy them.

    Args:
        actions: as the user passed them.
        shape: the required shape, (N, A).
        place: the device of the worlds.

    Raises:
        MorlaxError: `actions` is not a tensor, or has another shape or device.
    """
    if isinstance(actions, np.ndarray) and place.type == "cpu":
        try:
            actions = torch.tensor(actions, dtype=torch.float32)
        except TypeError:
            raise MorlaxError(f"actions must be numbers, not {actions.dtype}.") from None
    if not isinstance(actions, Tensor):
        raise MorlaxError(
            f"actions must be a torch tensor on {place}, not {type(actions).__name__}: use "
            "torch.as_tensor(actions, device=envs.device), or wrap the environment in "
            "gymnasium.wrappers.vector.ArrayConversion."
        )
    if actions.shape != shape:
        raise MorlaxError(
            f"actions need the shape {tuple(shape)}, one row per world, but have "
            f"{tuple(actions.shape)}."
        )
    if actions.device != place:
        raise MorlaxError(
            f"actions are on {actions.device}, but the worlds are on {place}: use "
            "actions.to(envs.device)."
        )
    return actions
