"""Running mean and variance."""

from typing import Final

import torch
from torch import Tensor, nn

from ..envs.worlds.mirror import Reflection
from ..gpu.group import ALONE, Group

LIMIT = 10.0  # standard deviations; values further out are clipped


class Normalizer(nn.Module):
    """Standardizes features by the running mean and variance of all updates.

    Accepts a prefix of the features, so policies can omit privileged ones. With a reflection of the
    features, statistics are those of mirror images too.
    """

    limit: Final[float] = LIMIT  # torch.jit.script knows no global constants

    def __init__(self, size: int, reflection: Reflection | None = None):
        super().__init__()
        self.mean = nn.Buffer(torch.zeros(size, dtype=torch.float32))
        self.variance = nn.Buffer(torch.ones(size, dtype=torch.float32))
        self.count = nn.Buffer(torch.zeros((), dtype=torch.float64))
        self.scale = nn.Buffer(torch.ones(size, dtype=torch.float32))  # 1 / standard deviation
        self._mirrors = reflection is not None
        if reflection is not None:
            self.mirror_order = nn.Buffer(reflection.order, persistent=False)
            self.mirror_sign = nn.Buffer(reflection.sign, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        size = x.shape[-1]
        centered = x - self.mean[:size]
        return (centered * self.scale[:size]).clamp(-self.limit, self.limit)

    def inverse(self, x: Tensor) -> Tensor:
        """Map normalized values back to natural units."""
        size = x.shape[-1]
        return x / self.scale[:size] + self.mean[:size]

    @torch.no_grad()
    def update(self, x: Tensor, weight: float | Tensor = 1.0, group: Group = ALONE) -> None:
        """Merge a batch of inputs (..., size) into the statistics, in place (Chan et al., 1979).

        A `weight` below 1 scales down the batch's share of all samples. The batch is that of all
        processes of the `group`.
        """
        if self._mirrors:
            x = torch.cat([x, Reflection(self.mirror_order, self.mirror_sign)(x)])
        x = x.flatten(0, -2)
        batch_variance, batch_mean = torch.var_mean(x, 0, correction=0)
        batch_mean, batch_variance = group.moments(batch_mean, batch_variance)
        number = len(x) * group.size
        self.count += number
        share = (number / self.count).float() * weight
        shift = batch_mean - self.mean
        self.variance.lerp_(batch_variance, share).add_(shift.square() * share * (1 - share))
        self.mean.add_(shift * share)
        self.scale.copy_((self.variance + 1e-8).rsqrt())
