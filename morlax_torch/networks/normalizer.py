"""Running mean and variance."""

from typing import Final

import torch
from torch import Tensor, nn

from ..envs.worlds.mirror import Reflection
from ..gpu.group import ALONE, Group

LIMIT = 10.0  # standard deviations; values further out are clipped


class Normalizer(nn.Module):
    """Standardizes features by the running mean and variance of all updates.

    Accepts a prefix of the features, so policies can omit privileged ones.

    Args:
        size: number of features.
        rows: R, if each of R policies has statistics of its own: inputs are (..., R, B, size) then.
            0: one set of statistics, of inputs (..., size).
        reflection: of the features, where statistics are to be those of mirror images too.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor
    scale: Tensor  # one over the standard deviation
    mirror_order: Tensor
    mirror_sign: Tensor
    limit: Final[float] = LIMIT  # torch.jit.script knows no global constants

    def __init__(self, size: int, rows: int = 0, reflection: Reflection | None = None):
        super().__init__()
        self.size, self.rows = size, rows
        shape = (rows, 1, size) if rows else (size,)
        self.register_buffer("mean", torch.zeros(shape, dtype=torch.float32))
        self.register_buffer("variance", torch.ones(shape, dtype=torch.float32))
        counts = (rows, 1, 1) if rows else ()
        self.register_buffer("count", torch.zeros(counts, dtype=torch.float64))
        self.register_buffer("scale", torch.ones(shape, dtype=torch.float32))
        self._mirrors = reflection is not None
        if reflection is not None:
            self.register_buffer("mirror_order", reflection.order, persistent=False)
            self.register_buffer("mirror_sign", reflection.sign, persistent=False)

    def statistics(self) -> list[Tensor]:
        """Return the tensors that `update` changes."""
        return [self.mean, self.variance, self.count, self.scale]

    def forward(self, x: Tensor) -> Tensor:
        size = x.shape[-1]
        centered = x - self.mean[..., :size]
        return (centered * self.scale[..., :size]).clamp(-self.limit, self.limit)

    def inverse(self, x: Tensor) -> Tensor:
        """Map normalized values back to natural units."""
        size = x.shape[-1]
        return x / self.scale[..., :size] + self.mean[..., :size]

    def select(self, chosen: Tensor) -> "Normalizer":
        """Return a copy of the statistics of K chosen rows (K,), or of a single one ()."""
        found = Normalizer(self.size, len(chosen) if chosen.dim() else 0)
        for name, own in found.named_buffers():
            values = self.get_buffer(name).index_select(0, chosen.reshape(-1))
            setattr(found, name, values.view_as(own))
        return found

    @torch.no_grad()
    def update(self, x: Tensor, weight: float | Tensor = 1.0, group: Group = ALONE) -> None:
        """Merge a batch of inputs into the statistics, in place (Chan et al., 1979).

        A `weight` below 1 scales down the batch's share of all samples. The batch is that of all
        processes of the `group`.
        """
        if self._mirrors:
            x = torch.cat([x, Reflection(self.mirror_order, self.mirror_sign)(x)])
        x = x.movedim(-3, 0).flatten(1, -2) if self.rows else x.flatten(0, -2)
        batch_variance, batch_mean = torch.var_mean(x, -2, correction=0, keepdim=self.rows > 0)
        batch_mean, batch_variance = group.moments(batch_mean, batch_variance)
        number = x.shape[-2] * group.size
        self.count += number
        share = (number / self.count).float() * weight
        shift = batch_mean - self.mean
        self.variance.lerp_(batch_variance, share).add_(shift.square() * share * (1 - share))
        self.mean.add_(shift * share)
        self.scale.copy_((self.variance + 1e-8).rsqrt())
