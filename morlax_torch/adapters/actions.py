"""Check the actions that a user passes to N worlds."""

from torch import Size, Tensor, device

from ..envs import MorlaxError


def check_actions(actions: Tensor, shape: Size, place: device) -> None:
    """Check the type, shape and device of actions; their values are not checked.

    Args:
        actions: as the user passed them.
        shape: the required shape, (N, A).
        place: the device of the worlds.

    Raises:
        MorlaxError: `actions` is not a tensor, or has another shape or device.
    """
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
