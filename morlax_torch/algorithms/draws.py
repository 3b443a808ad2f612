"""The trade-offs that an iteration explores, or a gradient step learns."""

import torch
from torch import Tensor

from ..configuration.config import Config
from ..configuration.tradeoffs import even_tradeoffs, sample_cells, sample_tradeoffs


class TradeoffDraws:
    """Draws trade-offs (K, m) as `config.sampling` says."""

    def __init__(self, config: Config, num_objectives: int, device: torch.device):
        sampling = config.sampling
        self._alpha = sampling.alpha
        self._corners = config.num_corners(num_objectives)
        self._focus: Tensor | None = None
        if sampling.focus is not None:
            *weights, self._until = sampling.focus
            focus = torch.tensor(weights, dtype=torch.float32, device=device)
            self._focus = focus / focus.sum()
        self._centers: Tensor | None = None  # of the cells
        others = config.num_clusters - self._corners
        if sampling.cells and sampling.mode == "sparse" and others >= num_objectives:
            self._centers = even_tradeoffs(others, num_objectives).to(device)

    def fill(self, out: Tensor, generator: torch.Generator, done: Tensor) -> None:
        """Fill `out` (K, m) when a share () of training is done. Runs inside a recorded graph."""
        if self._centers is None:
            sample_tradeoffs(out, self._corners, self._alpha, generator)
        else:
            sample_cells(out[: len(self._centers)], self._centers, generator)
            out[len(self._centers) :] = torch.eye(self._corners, out.shape[1], device=out.device)
        if self._focus is not None:
            away = (done / self._until).clamp(max=1.0)
            out.copy_(torch.lerp(self._focus, out, away))
