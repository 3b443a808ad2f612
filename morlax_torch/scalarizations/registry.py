"""Scalarizations by name."""

import torch

from ..envs import MorlaxError
from ..envs.errors import unknown
from ..envs.external import import_file
from ..envs.naming import is_file
from .chebyshev import AugmentedChebyshev, SmoothChebyshev
from .interface import Scalarization
from .linear import Linear
from .own import OwnUtility


def make_scalarization(name: str, num_objectives: int, device: torch.device) -> Scalarization:
    """Make the scalarization that a config names.

    Args:
        name: linear, chebyshev, augmented-chebyshev, or FILE.py:FUNCTION.
        num_objectives: m.
        device: of the returns.

    Raises:
        MorlaxError: the file has no such function, or the function cannot be used.
    """
    if name == "linear":
        return Linear()
    if name == "chebyshev":
        return SmoothChebyshev(num_objectives, device)
    if name == "augmented-chebyshev":
        return AugmentedChebyshev(num_objectives, device)
    if not is_file(name):
        raise MorlaxError(f"there is no scalarization {name!r}.")
    file, _, member = name.rpartition(":")
    module = import_file(file, f"the utility {member}")
    functions = {key for key, value in vars(module).items() if callable(value)}
    if member not in functions:
        raise unknown(f"function of {file}", member, functions)
    return OwnUtility(getattr(module, member), name, num_objectives, device)
