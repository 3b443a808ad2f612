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
    vector: Tensor,  # (P,) parameters
    gradients: Sequence[Tensor],
    means: Tensor,  # (P,) first moments
    squares: Tensor,  # (P,) second moments
    steps: Tensor,  # () taken
    rate: Tensor,  # ()
    max_norm: float,
    norms: Tensor | None = None,  # ()
) -> None:
    """Scale gradients down to a joint norm of `max_norm` and take a step of Adam, in place.

    The gradients are those of consecutive parts of the vector, of any shapes. The norm before
    scaling is added to `norms`.
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
    Parameters of several `networks`, which share nothing, are clipped network by network.
    """

    def __init__(
        self,
        parameters: Sequence[nn.Parameter],
        rate: float,
        max_norm: float,
        networks: int = 1,
        group: Group = ALONE,
    ):
        self.parameters, self.initial_rate = list(parameters), rate
        self.max_norm, self.networks, self.group = max_norm, networks, group
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
        return [self.mean, self.square, self.steps, self.rate]

    def restart(self) -> None:
        """Reset moments, step count and learning rate; keep the current parameters."""
        for value in (self.mean, self.square, self.steps):
            value.zero_()
        self.rate.fill_(self.initial_rate)

    def step(self, loss: Tensor) -> None:
        """Descend the gradient of `loss`."""
        # with a given first gradient, torch would import SymPy for seconds
        gradients = torch.autograd.grad(loss, self.parameters)
        if self.group.size > 1:  # in one collective
            flat = self.group.mean_(torch.cat([gradient.flatten() for gradient in gradients]))
            gradients = [*flat.split([gradient.numel() for gradient in gradients])]
        max_norm, norms = self.max_norm, self.norms
        if self.networks > 1:
            gradients, max_norm, norms = self._clipped(gradients), math.inf, None
        state = self.mean, self.square, self.steps, self.rate
        self._step(self.vector, gradients, *state, max_norm, norms)

    def _clipped(self, gradients: Sequence[Tensor]) -> list[Tensor]:
        """Clip the gradients of R networks, one by one; a mean over them has divided the loss."""
        rows = [gradient.reshape(self.networks, -1) for gradient in gradients]
        norm = torch.cat([self.networks * row for row in rows], 1).norm(dim=1, keepdim=True)
        self.norms += norm.mean()
        scale = self.networks / (norm / self.max_norm).clamp(min=1.0)
        return [row * scale for row in rows]
