"""Tasks whose Pareto front has a closed form."""

import math
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from morlax_torch import envs

PLACES = torch.tensor([[-0.5, 0.0], [0.5, 0.0]])  # of `Quadratic` and `Concave`, one per objective
STEPS, GROWTH = 10, 4.0  # of `Sprint`


class OneStep(envs.Worlds):
    """Episodes of one step, whose returns depend on the action alone.

    Subclasses define `returns`, the rewards (N, m) of actions (N, A), and `front`, about `number`
    points (n, m) of the front, evenly along the parameters that the class describes.
    """

    class Options(envs.ObjectiveOptions):
        objectives: dict[str, dict[str, float]] = {"left": {"left": 1.0}, "right": {"right": 1.0}}

    simulator = "closed form"
    resumable = True
    episode_length = 1
    observation_size, action_size = 1, 2
    reward_terms: ClassVar[tuple[str, ...]] = ("left", "right")

    def __init__(self, options, num_worlds, device, seed, auto_reset):
        super().__init__(options, num_worlds, device, seed, auto_reset)
        self.episode_length = type(self).episode_length
        self.define_objectives()

    @classmethod
    def build(cls, options, num_worlds, device, backend, seed, *, auto_reset, deterministic):
        return cls(options, num_worlds, device, seed, auto_reset)

    def restart(self, which: Tensor) -> Tensor:
        return self.critic_observation()

    def step(self, action: Tensor) -> envs.TimeStep:
        terms = dict(zip(self.reward_terms, self.returns(action).unbind(1), strict=True))
        ended = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        seen = self.critic_observation()
        return envs.TimeStep(seen, self.combine(terms), ended, ~ended, seen, terms, seen, seen)

    def state_dict(self) -> dict[str, Tensor]:
        return {"generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        self.generator.set_state(state["generator"])

    def critic_observation(self) -> Tensor:
        return torch.ones(self.num_worlds, 1, device=self.device)


class Quadratic(OneStep):
    """A point that an action (x, y) puts somewhere; 1 - distance² to each of two places."""

    @classmethod
    def returns(cls, action: Tensor) -> Tensor:
        places = PLACES.to(action.device)
        return cls.near((action[:, None] - places).square().sum(-1))

    @staticmethod
    def near(squared_distance: Tensor) -> Tensor:
        return 1 - squared_distance

    @classmethod
    def front(cls, number: int) -> Tensor:
        share = torch.linspace(0, 1, number)[:, None]
        return cls.returns(share * PLACES[0] + (1 - share) * PLACES[1])


class Concave(Quadratic):
    """As `Quadratic`, with exp(-4 distance²) to each place: a front that is mostly concave.

    (The problem of Fonseca and Fleming, 1995.) All points between the places are optimal.
    """

    @staticmethod
    def near(squared_distance: Tensor) -> Tensor:
        return torch.exp(-4 * squared_distance)


class Sphere(OneStep):
    """Two angles on an octant of a sphere: a concave front of three objectives.

    (DTLZ2 of Deb, Thiele, Laumanns and Zitzler, 2002.) The returns are 1 - f, with |f| = 1 on the
    front; the third action lengthens f unless it is 0.5.
    """

    class Options(envs.ObjectiveOptions):
        objectives: dict[str, dict[str, float]] = {name: {name: 1.0} for name in "abc"}

    action_size = 3
    reward_terms = ("a", "b", "c")

    @classmethod
    def returns(cls, action: Tensor) -> Tensor:
        one, other = ((1 + action[:, :2]) * math.pi / 4).unbind(1)
        longer = 1 + (action[:, 2:] - 0.5).square()
        return 1 - longer * cls.direction(one, other)

    @staticmethod
    def direction(one: Tensor, other: Tensor) -> Tensor:
        return torch.stack([one.cos() * other.cos(), one.cos() * other.sin(), one.sin()], 1)

    @classmethod
    def front(cls, number: int) -> Tensor:
        share = torch.linspace(0, 1, math.isqrt(number))
        # equal areas: the third coordinate of a uniform point on a sphere is uniform
        one, other = torch.cartesian_prod(share.asin(), share * math.pi / 2).unbind(1)
        return 1 - cls.direction(one, other)


class Sprint(OneStep):
    """A point on a line that moves by action / STEPS, for STEPS steps: get far, or save energy.

    The energy of every step is paid at once: (1 - action²) / STEPS. The distance x is paid only at
    the end, and more than in proportion: (exp(GROWTH x) - 1) / (exp(GROWTH) - 1). The least energy
    for a distance is that of equal steps, so all actions of an episode must agree.
    """

    class Options(envs.ObjectiveOptions):
        objectives: dict[str, dict[str, float]] = {"far": {"far": 1.0}, "energy": {"energy": 1.0}}

    episode_length = STEPS
    observation_size, action_size = 2, 1
    reward_terms = ("far", "energy")

    def __init__(self, options, num_worlds, device, seed, auto_reset):
        super().__init__(options, num_worlds, device, seed, auto_reset)
        self.x, self.age = torch.zeros(2, num_worlds, device=device)
        self._never = torch.zeros(num_worlds, dtype=torch.bool, device=device)

    @staticmethod
    def far(x: Tensor) -> Tensor:
        return torch.expm1(GROWTH * x) / math.expm1(GROWTH)

    @classmethod
    def front(cls, number: int) -> Tensor:
        x = torch.linspace(0, 1, number)
        return torch.stack([cls.far(x), 1 - x.square()], 1)

    def restart(self, which: Tensor) -> Tensor:
        self.x.masked_fill_(which, 0.0)
        self.age.masked_fill_(which, 0.0)
        return self.critic_observation()

    def step(self, action: Tensor) -> envs.TimeStep:
        self.x += action[:, 0] / STEPS
        self.age += 1
        ended = self.age >= STEPS
        energy = (1 - action[:, 0].square()) / STEPS
        terms = {"far": torch.where(ended, self.far(self.x), 0.0), "energy": energy}
        final = self.critic_observation()
        if self.auto_reset:
            self.restart(ended)
        seen = self.critic_observation()
        return envs.TimeStep(
            seen, self.combine(terms), ended, self._never, final, terms, seen, final
        )

    def state_dict(self) -> dict[str, Tensor]:
        return {**super().state_dict(), "x": self.x.clone(), "age": self.age.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        super().load_state_dict(state)
        self.x.copy_(state["x"])
        self.age.copy_(state["age"])

    def critic_observation(self) -> Tensor:
        return torch.stack([self.x, self.age / STEPS], 1)


def best_returns(tradeoffs: Tensor) -> Tensor:
    """Return the returns (K, m) of `Quadratic` that are optimal for trade-offs (K, m).

    The weighted sum of squared distances is least in the weighted mean of the places.
    """
    return Quadratic.returns(tradeoffs @ PLACES)


def covered(returns: NDArray[np.float64], front: Tensor, within: float) -> float:
    """Return the share of the points of a front that are `within` a distance of some return."""
    distances = torch.cdist(front.double(), torch.from_numpy(returns).double())
    return (distances.amin(1) <= within).double().mean().item()
