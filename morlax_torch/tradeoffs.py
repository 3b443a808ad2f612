"""Trade-offs: points of the simplex that weigh the objectives."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from .envs import MorlaxError

TINY = 1e-30  # keeps a trade-off finite if every gamma draw underflows to zero


def sample_tradeoffs(
    out: Tensor, corners: int = 0, alpha: float = 1.0, generator: torch.Generator | None = None
) -> None:
    """Fill `out` (K, m) with Dirichlet(alpha) draws, its last `corners` rows with corners."""
    # independent gamma draws divided by their sum are a Dirichlet draw
    out.copy_(torch._standard_gamma(torch.full_like(out, alpha), generator=generator))
    out.clamp_(min=TINY).div_(out.sum(-1, keepdim=True))
    if corners:
        out[-corners:] = torch.eye(corners, device=out.device)


def dirichlet_tradeoffs(
    number: int, num_objectives: int, seed: int = 0, alpha: float = 1.0
) -> Tensor:
    """Draw (number, m) from Dirichlet(alpha), the same on every machine for the same seed."""
    draws = np.random.default_rng(seed).dirichlet(np.full(num_objectives, alpha), number)
    return torch.from_numpy(draws).float()


def evaluation_tradeoffs(number: int, num_objectives: int) -> Tensor:
    """Return the fixed trade-offs (number, m) to evaluate a front by.

    With two objectives they are an even grid; with more, the corners and Dirichlet draws.

    Raises:
        MorlaxError: there are fewer trade-offs than objectives.
    """
    if number < num_objectives:
        raise MorlaxError(
            f"{number} trade-offs are too few: at least one is needed for each of the "
            f"{num_objectives} objectives."
        )
    if num_objectives == 2:
        first = torch.linspace(0, 1, number)
        return torch.stack([first, 1 - first], -1)
    corners = torch.eye(num_objectives)
    return torch.cat([corners, dirichlet_tradeoffs(number - num_objectives, num_objectives)])


def typical_tradeoffs(num_objectives: int) -> Tensor:
    """Return the corners and, in their middle, the balanced trade-off, (m + 1, m)."""
    corners, middle = torch.eye(num_objectives), num_objectives // 2
    balanced = torch.full((1, num_objectives), 1 / num_objectives)
    return torch.cat([corners[:middle], balanced, corners[middle:]])


def checked_tradeoff(
    tradeoff: Tensor | Sequence[float], objectives: Sequence[str], device: torch.device
) -> Tensor:
    """Convert one trade-off (m,) or several (K, m) to float32 on the device.

    Raises:
        MorlaxError: it is not a trade-off.
    """
    if not isinstance(tradeoff, Tensor):
        try:
            tradeoff = torch.from_numpy(np.asarray(tradeoff, dtype=np.float32))
        except (TypeError, ValueError):
            raise MorlaxError(f"a trade-off consists of numbers, not {tradeoff!r}.") from None
    tradeoff = tradeoff.to(device, torch.float32)
    m = len(objectives)
    if tradeoff.ndim not in (1, 2) or tradeoff.shape[-1] != m:
        raise MorlaxError(
            f"a trade-off needs {m} numbers ({', '.join(objectives)}), but the shape "
            f"is {tuple(tradeoff.shape)}."
        )
    if not (tradeoff.isfinite() & (tradeoff >= 0)).all() or not (tradeoff.sum(-1) > 0).all():
        raise MorlaxError(
            "a trade-off must be finite, not negative, and not zero in every objective."
        )
    return tradeoff


def one_tradeoff(
    tradeoff: Tensor | Sequence[float], objectives: Sequence[str], device: torch.device
) -> Tensor:
    """Convert one trade-off (m,) to float32 on the device.

    Raises:
        MorlaxError: it is not exactly one trade-off.
    """
    checked = checked_tradeoff(tradeoff, objectives, device)
    if checked.ndim != 1:
        raise MorlaxError(f"one trade-off is needed, not {len(checked)}.")
    return checked


def parse_tradeoff(text: str, objectives: Sequence[str]) -> tuple[float, ...]:
    """Parse a trade-off such as "0.8,0.2", one number per objective.

    Raises:
        MorlaxError: it is not a trade-off.
    """
    names = f"{len(objectives)} numbers ({', '.join(objectives)}), as in " + ",".join(
        f"{1 / len(objectives):.2g}" for _ in objectives
    )
    try:
        tradeoff = tuple(float(number) for number in text.split(","))
    except ValueError:
        raise MorlaxError(f"the trade-off {text!r} does not consist of {names}.") from None
    if len(tradeoff) != len(objectives):
        raise MorlaxError(f"the trade-off {text!r} has {len(tradeoff)}, but needs {names}.")
    if not all(math.isfinite(number) and number >= 0 for number in tradeoff) or not any(tradeoff):
        raise MorlaxError(
            f"the trade-off {text!r} must be finite, not negative, and not zero in every objective."
        )
    return tradeoff
