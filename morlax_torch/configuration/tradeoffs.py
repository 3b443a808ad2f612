"""Trade-offs: points of the simplex that weigh the objectives."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ..envs import MorlaxError

DRAWS = 32  # per cell of the simplex, so that almost every cell gets one


def sample_tradeoffs(
    out: Tensor, corners: int = 0, alpha: float = 1.0, generator: torch.Generator | None = None
) -> None:
    """Fill `out` (K, m) with Dirichlet(alpha) draws, its last `corners` rows with corners."""
    # independent gamma draws divided by their sum are a Dirichlet draw
    if alpha < 1:
        # float32 cannot hold the small draws of Gamma(0.01), but their logarithms:
        # log Gamma(alpha) = log Gamma(alpha + 1) - Exponential(1) / alpha
        larger = torch._standard_gamma(torch.full_like(out, alpha + 1), generator=generator)
        smaller = torch.empty_like(out).exponential_(generator=generator) / alpha
        out.copy_((larger.log() - smaller).softmax(-1))
    else:
        out.copy_(torch._standard_gamma(torch.full_like(out, alpha), generator=generator))
        out.div_(out.sum(-1, keepdim=True))
    if corners:
        out[-corners:] = torch.eye(corners, device=out.device)


def sample_cells(out: Tensor, centers: Tensor, generator: torch.Generator | None = None) -> None:
    """Fill `out` (K, m) with one draw from the cell of each of the `centers` (K, m).

    The cell of a center is what is nearer to it than to the others. Draws are uniform on a simplex
    that is larger by half a step of the grid on every side, so that all cells of a regular grid are
    equally large, and move to the nearest point of the simplex: half of those of an end of two
    objectives' grid are the corner. (The authors' code of HYPER-MORL, Shu et al., 2024.)
    """
    drawn = out.new_empty(DRAWS * len(centers), out.shape[1])
    sample_tradeoffs(drawn, generator=generator)
    margin = _squared_distances(centers, centers).fill_diagonal_(math.inf).amin().div(8).sqrt()
    drawn = drawn * (1 + out.shape[1] * margin) - margin
    cells = torch.arange(len(centers), device=out.device)[:, None]
    inside = _squared_distances(drawn, centers).argmin(1) == cells
    first = inside.to(torch.uint8).argmax(1)  # the draws are independent, so any will do
    out.copy_(torch.where(inside.any(1, keepdim=True), onto_simplex(drawn[first]), centers))


def _squared_distances(points: Tensor, others: Tensor) -> Tensor:
    """Return (n, k) for points (n, m) and (k, m); torch.cdist may round to TF32."""
    return (points[:, None] - others).square().sum(-1)


def onto_simplex(points: Tensor) -> Tensor:
    """Return the points of the simplex that are nearest to points (n, m) (Held et al., 1974)."""
    ordered = points.sort(-1, descending=True).values
    counts = torch.arange(1, points.shape[-1] + 1, device=points.device)
    excess = (ordered.cumsum(-1) - 1) / counts
    positive = (ordered > excess).sum(-1, keepdim=True)  # weights that stay
    return (points - excess.gather(-1, positive - 1)).clamp(min=0)


def even_tradeoffs(number: int, num_objectives: int) -> Tensor:
    """Return trade-offs (number, m) spread evenly over the simplex, its corners among them.

    With two objectives they are an even grid. With more, each is the point of a fine lattice that
    is farthest from those before it (Gonzalez, 1985), starting from the corners.
    """
    _check_number(number, num_objectives)
    if num_objectives == 2:
        first = torch.linspace(0, 1, number, dtype=torch.float32, device="cpu")
        return torch.stack([first, 1 - first], -1)
    lattice = _lattice(number, num_objectives)
    chosen = list(torch.eye(num_objectives, dtype=torch.float64, device="cpu"))
    distance = torch.cdist(lattice, torch.stack(chosen)).amin(1)
    while len(chosen) < number:
        chosen.append(lattice[distance.argmax()])
        distance = torch.minimum(distance, (lattice - chosen[-1]).norm(dim=1))
    return torch.stack(chosen).float()


def _lattice(number: int, num_objectives: int) -> Tensor:
    """Return points of the simplex whose weights are multiples of 1/H, at least 8 x `number`."""
    m = H = num_objectives  # multiples of which have the balanced trade-off
    while math.comb(H + m - 1, m - 1) < 8 * number:
        H += m
    bars = torch.combinations(torch.arange(H + m - 1, device="cpu"), m - 1)
    ends = bars.new_full((len(bars), 1), H + m - 1)
    counts = torch.diff(torch.cat([ends * 0 - 1, bars, ends], 1)) - 1
    return counts.double() / H


def _check_number(number: int, num_objectives: int) -> None:
    if number < num_objectives:
        raise MorlaxError(
            f"{number} trade-offs are too few: at least one is needed for each of the "
            f"{num_objectives} objectives."
        )


def dirichlet_tradeoffs(number: int, num_objectives: int, seed: int = 0) -> Tensor:
    """Draw (number, m) uniformly from the simplex, the same on every machine for the same seed."""
    draws = np.random.default_rng(seed).dirichlet(np.ones(num_objectives), number)
    return torch.from_numpy(draws).float()


def evaluation_tradeoffs(number: int, num_objectives: int) -> Tensor:
    """Return fixed trade-offs (number, m): an even grid if m is 2, else corners and draws."""
    _check_number(number, num_objectives)
    if num_objectives == 2:
        return even_tradeoffs(number, num_objectives)
    corners = torch.eye(num_objectives, dtype=torch.float32, device="cpu")
    return torch.cat([corners, dirichlet_tradeoffs(number - num_objectives, num_objectives)])


def typical_tradeoffs(num_objectives: int) -> Tensor:
    """Return the corners and, in their middle, the balanced trade-off, (m + 1, m)."""
    corners = torch.eye(num_objectives, dtype=torch.float32, device="cpu")
    balanced, middle = corners.mean(0, keepdim=True), num_objectives // 2
    return torch.cat([corners[:middle], balanced, corners[middle:]])


def checked_tradeoff(
    tradeoff: Tensor | Sequence[float], objectives: Sequence[str], device: torch.device
) -> Tensor:
    """Convert a trade-off (m,) or several (K, m) to float32 on the device, or raise MorlaxError."""
    numbers = tradeoff
    if not isinstance(numbers, Tensor):
        try:
            # a copy: torch takes no negative strides, and warns of arrays that are read-only
            numbers = torch.from_numpy(np.array(tradeoff, order="C"))
        except (TypeError, ValueError):
            numbers = None
    if numbers is None or numbers.is_complex():
        raise MorlaxError(f"a trade-off consists of real numbers, not {tradeoff!r}.")
    tradeoff, m = numbers.to(device, torch.float32), len(objectives)
    if tradeoff.ndim not in (1, 2) or tradeoff.shape[-1] != m:
        many = tradeoff.shape[-1] if tradeoff.ndim in (1, 2) else f"shape {tuple(tradeoff.shape)}"
        raise MorlaxError(f"a trade-off needs {m} numbers ({', '.join(objectives)}), not {many}.")
    if torch.compiler.is_exporting() or torch._C._are_functorch_transforms_active():
        return tradeoff  # numbers cannot be looked at
    if not (tradeoff.isfinite() & (tradeoff >= 0)).all() or not (tradeoff.sum(-1) > 0).all():
        raise MorlaxError(
            "a trade-off must be finite, not negative, and not zero in every objective."
        )
    return tradeoff


def one_tradeoff(
    tradeoff: Tensor | Sequence[float], objectives: Sequence[str], device: torch.device
) -> Tensor:
    """Convert exactly one trade-off (m,) to float32 on the device, or raise MorlaxError."""
    checked = checked_tradeoff(tradeoff, objectives, device)
    if checked.ndim != 1:
        raise MorlaxError(f"one trade-off is needed, not {len(checked)}.")
    return checked


def parse_tradeoff(text: str, objectives: Sequence[str]) -> tuple[float, ...]:
    """Parse a trade-off such as "0.8,0.2", one number per objective, or raise MorlaxError."""
    try:
        tradeoff = tuple(float(number) for number in text.split(","))
    except ValueError:
        even = ",".join(f"{1 / len(objectives):.2g}" for _ in objectives)
        raise MorlaxError(f"the trade-off {text!r} must be numbers, such as {even}.") from None
    one_tradeoff(tradeoff, objectives, torch.device("cpu"))
    return tradeoff
