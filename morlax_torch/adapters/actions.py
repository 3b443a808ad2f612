"""What a user gives as actions of N worlds."""

from torch import Size, Tensor, device

from ..envs import MorlaxError


def check_actions(actions: Tensor, shape: Size, place: device) -> None:
    """See to the shape (N, A) and the device; the numbers are not looked at.

    Raises:
        MorlaxError: they are no tensor, or of another shape or device.
    """
    if not isinstance(actions, Tensor):
        raise MorlaxError(
            f"actions are torch tensors on {place}, not {type(actions).__name__}: use "
            "torch.as_tensor(actions, device=envs.device), or wrap the environment in "
            "gymnasium.wrappers.vector.ArrayConversion."
        )
    if actions.shape != shape:
        raise MorlaxError(
            f"actions need the shape {tuple(shape)}, a row for each world, but have "
            f"{tuple(actions.shape)}."
        )
    if actions.device != place:
        raise MorlaxError(
            f"actions lie on {actions.device}, but the worlds are on {place}: use "
            "actions.to(envs.device)."
        )
