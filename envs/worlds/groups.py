"""Groups of observations, as mjlab, Isaac Lab and rsl_rl name them."""

from typing import Any

import torch
from torch import Tensor

from ..errors import MorlaxError

ACTORS = ("actor", "policy")  # names of the group that a policy sees
CRITIC = "critic"  # what only critics see


def actor_group(groups: Any, owner: str) -> str:
    """Return the name of the group that a policy sees.

    Raises:
        MorlaxError: `owner` has no such group, or a group that is not one vector.
    """
    known = list(groups.keys())
    actor = next((name for name in ACTORS if name in known), None)
    if actor is None:
        raise MorlaxError(
            f"{owner} has no observations called actor or policy, but {', '.join(known)}."
        )
    for name in {actor, CRITIC} & set(known):
        if not isinstance(groups[name], Tensor) or groups[name].ndim != 2:
            raise MorlaxError(
                f"the observations {name} of {owner} are not one vector for each world: policies "
                "cannot take images or parts that are not concatenated."
            )
    return actor


def joined(groups: Any, actor: str) -> Tensor:
    """Return what a policy sees, then what only critics see, (N, O + P)."""
    parts = [groups[actor], *([groups[CRITIC]] if CRITIC in list(groups.keys()) else [])]
    return torch.cat(parts, 1).float()
