"""Adam with gradient clipping, over one flat vector of parameters."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.optim.adam import adam

from ..configuration.sections import DECAYS, EPSILON
from . import fused
from .group import ALONE, Group


def step(
    vector: Tensor,
    gradients: Sequence[Tensor],
    means: Tensor,
    squares: Tensor,
    steps: Tensor,
    rate: Tensor,
    max_norm: float,
    norms: Tensor | None = None,
) -> None:
    """Scale gradients down to a joint norm of `max_norm` and take a step of Adam, in place.

    Args:
        vector: the parameters (P,).
        gradients: of consecutive parts of the vector, of any shapes.
        means: the first moments (P,).
        squares: the second moments (P,).
        steps: the number of steps taken ().
        rate: the learning rate ().
        max_norm: largest norm of the gradients.
        norms: () increased by the norm of the gradients before scaling, in place, if given.
    """
    gradient = torch.cat([g.flatten() for g in gradients])
    norm = gradient.norm()
    if norms is not None:
        norms += norm
    adam(
        [vector],
        [gradient],
        [means],
        [squares],
        max_exp_avg_sqs=[],
        state_steps=[steps],
        fused=True,
        grad_scale=(norm / max_norm).clamp(min=1.0),
        amsgrad=False,
        beta1=DECAYS[0],
        beta2=DECAYS[1],
        lr=rate,
        weight_decay=0.0,
        eps=EPSILON,
        maximize=False,
    )


class ClippedAdam:
    """Adam (Kingma and Ba, 2015) on gradients scaled down to a norm of `max_norm`.

    The parameters become views of one vector, so that a step is a handful of kernels. All state
    lives in tensors that are updated in place, because a recorded graph knows them by address.

    Args:
        parameters: updated in place.
        rate: the learning rate.
        max_norm: largest norm of the gradients.
        networks: of how many networks, which share nothing, the parameters consist; each has its
            own norm then, of gradients times their number, which a mean over them divided by.
        group: processes over which gradients are averaged.
    """

    def __init__(
        self,
        parameters: Sequence[nn.Parameter],
        rate: float,
        max_norm: float,
        networks: int = 1,
        group: Group = ALONE,
    ):
        self.parameters, self.max_norm, self.networks = list(parameters), max_norm, networks
        self.group = group
        self.vector = torch.cat([p.detach().flatten() for p in self.parameters])
        parts = self.vector.split([p.numel() for p in self.parameters])
        for parameter, part in zip(self.parameters, parts, strict=True):
            parameter.data = part.view_as(parameter)
        self.mean, self.square = torch.zeros_like(self.vector), torch.zeros_like(self.vector)
        self.steps, self.rate = self.vector.new_zeros(()), self.vector.new_tensor(rate)
        kernels = fused.kernels(self.vector.device)
        self._step = kernels.step if kernels else step
        self.norms = torch.zeros_like(self.rate)
        """Sum over steps of the gradients' norm before clipping, a mean over networks."""

    def state(self) -> list[Tensor]:
        """Return the moments, the number of steps and the learning rate."""
        return [self.mean, self.square, self.steps, self.rate]

    def forget(self) -> None:
        """Reset moments and step count; keep the current parameters."""
        for value in (self.mean, self.square, self.steps):
            value.zero_()

    def step(self, loss: Tensor) -> None:
        """Descend the gradient of `loss`."""
        # with a given first gradient, torch would import SymPy for seconds
        gradients = self._averaged(torch.autograd.grad(loss, self.parameters))
        max_norm, norms = self.max_norm, self.norms
        if self.networks > 1:
            gradients, max_norm, norms = self._clipped(gradients), math.inf, None
        state = self.mean, self.square, self.steps, self.rate
        self._step(self.vector, gradients, *state, max_norm, norms)

    def _averaged(self, gradients: Sequence[Tensor]) -> Sequence[Tensor]:
        """Average gradients over the processes, in one collective."""
        if self.group.size == 1:
            return gradients
        flat = self.group.mean_(torch.cat([gradient.flatten() for gradient in gradients]))
        parts = flat.split([gradient.numel() for gradient in gradients])
        return [part.view_as(own) for part, own in zip(parts, gradients, strict=True)]

    def _clipped(self, gradients: Sequence[Tensor]) -> tuple[Tensor, ...]:
        """Clip the gradients (R, ...) of every network by itself."""
        rows = [self.networks * gradient.flatten(1) for gradient in gradients]
        norm = torch.cat(rows, 1).norm(dim=1, keepdim=True)
        self.norms += norm.mean()
        scale = self.networks / (norm / self.max_norm).clamp(min=1.0)
        return tuple((gradient.flatten(1) * scale).view_as(gradient) for gradient in gradients)
