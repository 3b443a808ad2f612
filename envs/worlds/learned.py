"""A reward term that is learned from comparisons of clips."""

import io
import zipfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from ..errors import MorlaxError, user_code

TERM = "learned"  # name of the reward term
FORMAT = 1
LIMITS = (-0.25, 1.25)  # of a step; more would make a short jump worth an early end


class LearnedReward(nn.Module):
    """An ensemble of E small networks that rate control steps; the reward is their mean.

    A step is the observation before it, its action, and the observation after it.
    `viewers.preferences.teaching.fit` trains one from comparisons (Christiano et al., 2017).
    """

    mean: Tensor
    scale: Tensor
    offset: Tensor
    unit: Tensor

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        members: int = 5,
        hidden: Sequence[int] = (64, 64),
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        self.observation_size, self.action_size = observation_size, action_size
        self.members, self.hidden = members, list(hidden)
        inputs = 2 * observation_size + action_size
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        single = torch.float32
        for rows, columns in pairwise((inputs, *hidden, 1)):
            drawn = torch.randn(members, rows, columns, generator=generator, dtype=single)
            self.weights.append(nn.Parameter(drawn / rows**0.5))
            self.biases.append(nn.Parameter(torch.zeros(members, 1, columns, dtype=single)))
        self.register_buffer("mean", torch.zeros(inputs, dtype=single))
        self.register_buffer("scale", torch.ones(inputs, dtype=single))  # 1 / std
        # ratings that earn nothing, and one more
        self.register_buffer("offset", torch.zeros((), dtype=single))
        self.register_buffer("unit", torch.ones((), dtype=single))

    def forward(self, before: Tensor, action: Tensor, after: Tensor) -> Tensor:
        """Return the rewards (N,) of steps from (N, O) under (N, A) to (N, O)."""
        ratings = self.ratings(torch.cat([before, action, after], -1)).mean(0)
        return ((ratings - self.offset) / self.unit).clamp(*LIMITS)

    def ratings(self, steps: Tensor) -> Tensor:
        """Return each network's rating (E, n) of steps (n, 2 O + A)."""
        x = ((steps.float() - self.mean) * self.scale).clamp(-10, 10).expand(self.members, -1, -1)
        *inner, last = zip(self.weights, self.biases, strict=True)
        for weight, bias in inner:
            x = leaky_relu(torch.baddbmm(bias, x, weight))
        weight, bias = last
        return torch.baddbmm(bias, x, weight).squeeze(-1)

    def contents(self) -> dict[str, Any]:
        """Return plain values and tensors that `load` restores."""
        names = "observation_size", "action_size", "members", "hidden"
        sizes = {name: getattr(self, name) for name in names}
        return {"format": FORMAT, **sizes, "state": self.state_dict()}

    @classmethod
    def load(cls, path: Path, observation_size: int, action_size: int) -> Self:
        """Read a learned reward of a task with O observations and A actions."""
        with user_code(f"cannot read the learned reward {path}"):
            data = path.read_bytes()
        # zip, pickle and torch each fail in their own way on a damaged file
        wrong = "is damaged or not one: fit it again with morlax teach"
        with user_code(f"the learned reward {path} {wrong}"):
            sound = zipfile.ZipFile(io.BytesIO(data)).testzip() is None  # torch checks no checksum
            values = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
            sound &= values.pop("format") == FORMAT
            state = values.pop("state")
            reward = cls(**values)
            reward.load_state_dict(state)
            if not (sound and all(value.isfinite().all() for value in state.values())):
                raise ValueError("not a sound learned reward")
        sizes = reward.observation_size, reward.action_size
        if sizes != (observation_size, action_size):
            raise MorlaxError(
                f"the learned reward {path} is for {sizes[0]} observations and {sizes[1]} actions, "
                f"but this task has {observation_size} and {action_size}."
            )
        return reward.requires_grad_(False)
