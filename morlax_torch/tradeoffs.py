"""Points of the simplex: how much each objective matters."""

import numpy as np
import torch
from torch import Tensor

from .envs import MorlaxError

TINY = 1e-30  # keeps a trade-off finite where every gamma draw underflowed to zero


def sample_tradeoffs(
    out: Tensor, corners: int = 0, alpha: float = 1.0, generator: torch.Generator | None = None
) -> None:
    """Fill `out` (K, m) with draws from Dirichlet(alpha), its last `corners` rows with corners."""
    # independent gamma draws divided by their sum are a Dirichlet draw
    out.copy_(torch._standard_gamma(torch.full_like(out, alpha), generator=generator))
    out.clamp_(min=TINY).div_(out.sum(-1, keepdim=True))
    if corners:
        out[-corners:] = torch.eye(corners, device=out.device)


def dirichlet_tradeoffs(number: int, num_objectives: int, seed: int = 0) -> Tensor:
    """(number, m) draws from Dirichlet(1, ..., 1), the same for the same seed everywhere."""
    draws = np.random.default_rng(seed).dirichlet(np.ones(num_objectives), number)
    return torch.from_numpy(draws).float()


def evaluation_tradeoffs(number: int, num_objectives: int) -> Tensor:
    """The fixed trade-offs (number, m) that a front is judged by.

    With two objectives they are an even grid; with more, the corners and Dirichlet draws.

    Raises:
        MorlaxError: they are fewer than the objectives.
    """
    if number < num_objectives:
        raise MorlaxError(
            f"{number} trade-offs are too few: it takes at least one for each of the "
            f"{num_objectives} objectives."
        )
    if num_objectives == 2:
        first = torch.linspace(0, 1, number)
        return torch.stack([first, 1 - first], -1)
    corners = torch.eye(num_objectives)
    return torch.cat([corners, dirichlet_tradeoffs(number - num_objectives, num_objectives)])
