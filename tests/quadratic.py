"""Tasks whose Pareto front has a closed form: stand as near as possible to several places."""

import torch
from torch import Tensor

from morlax_torch import envs

PLACES = torch.tensor([[-0.5, 0.0], [0.5, 0.0]])  # one per objective


class Quadratic(envs.Worlds):
    """A point that an action (x, y) puts somewhere, for one step; 1 - distance² to each place."""

    class Options(envs.ObjectiveOptions):
        objectives: dict[str, dict[str, float]] = {"left": {"left": 1.0}, "right": {"right": 1.0}}

    simulator = "quadratic"
    resumable = True
    observation_size, action_size = 1, 2
    reward_terms = ("left", "right")

    def __init__(self, options, num_worlds, device, seed, auto_reset):
        self.options, self.num_worlds, self.device = options, num_worlds, device
        self.auto_reset, self.episode_length = auto_reset, 1
        self.generator = torch.Generator(device).manual_seed(seed)
        self.define_objectives()
        self.blowups = torch.zeros((), dtype=torch.int64, device=device)

    @classmethod
    def build(cls, options, num_worlds, device, backend, seed, *, auto_reset, deterministic):
        return cls(options, num_worlds, device, seed, auto_reset)

    @staticmethod
    def near(squared_distance: Tensor) -> Tensor:
        return 1 - squared_distance

    def reset(self) -> Tensor:
        return self.critic_observation()

    def restart(self, which: Tensor) -> Tensor:
        return self.critic_observation()

    def step(self, action: Tensor) -> envs.TimeStep:
        near = self.near((action[:, None] - PLACES.to(self.device)).square().sum(-1))
        terms = dict(zip(self.reward_terms, near.unbind(1), strict=True))
        ended = torch.ones(self.num_worlds, dtype=torch.bool, device=self.device)
        seen = self.critic_observation()
        return envs.TimeStep(seen, self.combine(terms), ended, ~ended, seen, terms, seen, seen)

    def state_dict(self) -> dict[str, Tensor]:
        return {"generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        self.generator.set_state(state["generator"])

    def critic_observation(self) -> Tensor:
        return torch.ones(self.num_worlds, 1, device=self.device)


class Concave(Quadratic):
    """As `Quadratic`, with exp(-4 distance²) to each place: a front that is mostly concave.

    (The problem of Fonseca and Fleming, 1995.) All points between the places are optimal.
    """

    @staticmethod
    def near(squared_distance: Tensor) -> Tensor:
        return torch.exp(-4 * squared_distance)


def concave_front(number: int) -> Tensor:
    """Return `number` points (number, m) of the front of `Concave`."""
    between = torch.linspace(0, 1, number)[:, None]
    points = PLACES[0] + between * (PLACES[1] - PLACES[0])
    return Concave.near((points[:, None] - PLACES).square().sum(-1))


def best_returns(tradeoffs: Tensor) -> Tensor:
    """Return the returns (K, m) that are optimal for trade-offs (K, m).

    The weighted sum of squared distances is least in the weighted mean of the places.
    """
    point = tradeoffs @ PLACES
    return 1 - (point[:, None] - PLACES).square().sum(-1)
