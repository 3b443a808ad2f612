"""Scalarizations by name."""

from collections.abc import Sequence

import torch

from ..configuration.config import CONSTRAINED
from ..envs import trust
from ..envs.errors import unknown
from ..envs.external import import_file
from .chebyshev import AugmentedChebyshev, SmoothChebyshev
from .constrained import Constrained
from .interface import Linear, Scalarization
from .own import OwnUtility


def make_scalarization(name: str, objectives: Sequence[str], device: torch.device) -> Scalarization:
    """Make the scalarization that a config names.

    Args:
        name: linear, chebyshev, augmented-chebyshev, constrained:OBJECTIVE, or FILE.py:FUNCTION.
        objectives: their names.
        device: of the returns.

    The code of FILE.py runs, and files may name it from now on (see `envs.trust`).

    Raises:
        MorlaxError: the file has no such function, or the function cannot be used.
    """
    num_objectives = len(objectives)
    if name == "linear":
        return Linear()
    if name == "chebyshev":
        return SmoothChebyshev(num_objectives, device)
    if name == "augmented-chebyshev":
        return AugmentedChebyshev(num_objectives, device)
    if name.startswith(CONSTRAINED):
        constrained = objectives.index(name.removeprefix(CONSTRAINED))
        return Constrained(constrained, num_objectives, device)
    trust(name)
    file, _, member = name.rpartition(":")
    module = import_file(file, f"the utility {member}")
    functions = {key for key, value in vars(module).items() if callable(value)}
    if member not in functions:
        raise unknown(f"function of {file}", member, functions)
    return OwnUtility(getattr(module, member), name, num_objectives, device)
