"""PD-MORL: one conditioned policy, whose values are turned towards its trade-off."""

import math
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity, normalize, smooth_l1_loss

from ...algorithms.off_policy import OffPolicy, Transitions
from ...algorithms.rollout import Explore
from ...configuration.config import Config
from ...configuration.tradeoffs import even_tradeoffs, sample_cells, typical_tradeoffs
from ...envs import Worlds
from ...evaluation.evaluator import Evaluator, evaluation_worlds
from ...gpu.optimizer import ClippedAdam
from ...networks.family import Family
from ...networks.gaussian import TanhNormal
from ...networks.mlp import smaller
from .options import PDMORLOptions

MAX_NORM = 100.0  # of gradients
KEY_NOISE = 0.05  # standard deviation and limit, on the weights of key trade-offs
LIMIT = 1 - 1e-6  # of actions, whose atanh must be finite
MEASURING = 1  # seed of the episodes of key trade-offs; 0 is that of evaluations
PARALLEL = 0.9999  # cosine of vectors that count as parallel: the slope of acos has no limit


class Interpolator:
    """Interpolates between the returns of the key trade-offs: the corners and the balanced one.

    A sum of distances to the key trade-offs and a constant (radial basis functions of degree 1;
    Wright, 2003) goes through their returns, which are divided by their sum of absolute values.
    Until returns are known, the direction of a trade-off is the trade-off itself.
    """

    def __init__(self, num_objectives: int, device: torch.device):
        self.keys = typical_tradeoffs(num_objectives)
        points = self.keys.double()
        system = torch.ones(2 * [len(points) + 1], dtype=torch.float64)
        system[-1, -1] = 0.0
        system[:-1, :-1] = torch.cdist(points, points)
        self._inverse = system.inverse()
        self._points = self.keys.to(device)
        self._solutions = points.clone()  # (m + 1, m) the best returns
        self._known = torch.zeros((), dtype=torch.bool)
        self._coefficients = self._points.new_zeros(len(system), num_objectives)
        self._fit()

    def state(self) -> list[Tensor]:
        return [self._solutions, self._known, self._coefficients]

    def observe(self, returns: Tensor) -> None:
        """Keep the returns (m + 1, m) of key trade-offs whose weighted sum is the largest yet."""
        more = ((returns - self._solutions) * self.keys).sum(-1, keepdim=True) > 0
        self._solutions.copy_(torch.where(more | ~self._known, returns, self._solutions))
        self._known.fill_(True)
        self._fit()

    def _fit(self) -> None:
        values = normalize(self._solutions, p=1.0)
        self._coefficients.copy_(self._inverse @ torch.cat([values, torch.zeros_like(values[:1])]))

    def __call__(self, tradeoffs: Tensor) -> Tensor:
        """Map trade-offs (S, m) to directions (S, m) of any length."""
        distances = (tradeoffs[:, None] - self._points).norm(dim=-1, keepdim=True)
        # no matrix product, which would round to TF32
        return (distances * self._coefficients[:-1]).sum(1) + self._coefficients[-1]


def angle(one: Tensor, other: Tensor) -> Tensor:
    """Return the angle (...) between vectors (..., m) in degrees, from 0.8 to 90.

    Smaller and larger ones have no gradient, as in the authors' code of PD-MORL.
    """
    return cosine_similarity(one, other, -1).clamp(0.0, PARALLEL).acos().rad2deg()


class PDMORL(OffPolicy):
    """Trains one actor and one pair of twin critics that take the trade-off as an input.

    (Basaklar, Gumussoy and Ogras, 2023, "PD-MORL: Preference-Driven Multi-Objective Reinforcement
    Learning Algorithm".) TD3 (Fujimoto et al., 2018) for vector rewards. docs/algorithms.md
    explains it. It needs `network.type: conditioned`, and takes the arguments of `OffPolicy`.
    """

    losses = ("policy_loss", "value_loss", "angle")
    followed = ("actor", "critic")

    def __init__(self, env: Worlds, config: Config, **others: Any):
        super().__init__(env, config, **others)
        assert isinstance(config.method, PDMORLOptions)
        self.options = config.method
        families = self.agent.actor, self.agent.critic
        rate, group = self.options.learning_rate, self.group
        self.optimizers = tuple(
            ClippedAdam([*x.parameters()], rate, MAX_NORM, group=group) for x in families
        )
        self._state["optimizers"] = [x for adam in self.optimizers for x in adam.state()]
        K, m = self.tradeoffs.shape
        self._centers = even_tradeoffs(K, m).to(env.device)
        self._random = torch.zeros((), dtype=torch.bool, device=env.device)  # for graphs
        self.interpolator = Interpolator(m, env.device)
        self._state["interpolator"] = self.interpolator.state()
        keys, seeds = self.interpolator.keys, config.evaluation.seeds
        self._keys = keys.to(env.device)[torch.arange(K) % len(keys)]  # of clusters, at first
        worlds = evaluation_worlds(config, len(keys), seeds, MEASURING)
        self._evaluator = Evaluator(self.agent, worlds, keys, seed=MEASURING, seeds=seeds)

    def compile(self) -> None:
        super().compile()
        self._evaluator.compile()

    def iterate(self, done: float = 0.0) -> None:
        before = self.env_steps
        self._random.fill_(before < self.options.start * self.group.size)
        super().iterate(done)
        if before // self.options.refresh != self.env_steps // self.options.refresh:
            returns = torch.from_numpy(self._evaluator.evaluate().returns)
            self.interpolator.observe(self.group.first(returns))

    def _warming_up(self) -> Tensor:
        return self._done < self.options.warmup

    def _choose(self) -> Explore:
        sample_cells(self.tradeoffs, self._centers, self.generator)
        noise = torch.empty_like(self._keys).normal_(generator=self.generator)
        near = (self._keys + (KEY_NOISE * noise).clamp(-KEY_NOISE, KEY_NOISE)).abs()
        near = near / near.sum(-1, keepdim=True)
        self.tradeoffs.copy_(torch.where(self._warming_up(), near, self.tradeoffs))
        actors = self.agent.actors(self.tradeoffs)

        def explore(observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
            action = actors.act(observation) + self.options.exploration * noise
            uniform = torch.erf(noise / math.sqrt(2))
            action = torch.where(self._random, uniform, action).clamp(-LIMIT, LIMIT)
            return action.atanh(), torch.zeros_like(action[..., 0])

        return explore

    def _improve(self) -> None:
        """Take `delay` gradient steps of the critics, then one of the actor."""
        options, value_loss = self.options, torch.zeros_like(self._done)
        by_actor, by_critic = self.optimizers
        for _ in range(options.delay):
            rows = self.replay.sample(options.batch, 1, options.discount, self.generator)
            tradeoffs = self._relabeled(rows.tradeoff)
            seen = self._normalized(rows.observation)
            loss = self._critic_loss(rows, seen, tradeoffs)
            by_critic.step(loss)
            value_loss += loss.detach() / options.delay
        policy_loss, degrees = self._actor_loss(seen, tradeoffs)
        by_actor.step(policy_loss)
        self._follow(options.target_rate)
        losses = policy_loss, value_loss, degrees
        self._losses += torch.stack([loss.detach() for loss in losses])

    def _normalized(self, observation: Tensor) -> Tensor:
        """Return rows (S, 1, O + P): each row has a trade-off."""
        return self.agent.observation_normalizer(observation)[:, None]

    def _relabeled(self, tradeoffs: Tensor) -> Tensor:
        """Return trade-offs (S, m): a share of those that acted, and random ones."""
        drawn = torch.empty_like(tradeoffs).normal_(generator=self.generator).abs()
        drawn = drawn / drawn.sum(-1, keepdim=True)
        kept = len(tradeoffs) // (self.options.relabels + 1)
        drawn = torch.cat([tradeoffs[:kept], drawn[kept:]])
        return torch.where(self._warming_up(), tradeoffs, drawn)

    def _act(self, actor: Family, seen: Tensor, tradeoffs: Tensor) -> Tensor:
        """Return deterministic actions (S, 1, A)."""
        seen = seen[..., : self.agent.observation_size]
        return TanhNormal(actor.run(actor(tradeoffs), seen)).mode

    def _value(self, critic: Family, seen: Tensor, action: Tensor, tradeoffs: Tensor) -> Tensor:
        """Return the values (S, 1, 2m) of twins."""
        return critic.run(critic(tradeoffs), torch.cat([seen, action], -1))

    def _angle(self, twins: Tensor, tradeoffs: Tensor) -> Tensor:
        """Return the mean angle () in degrees between values (S, 1, n, m) and their directions."""
        return angle(twins, self.interpolator(tradeoffs)[:, None, None]).mean()

    def _guided(self, weight: float) -> Tensor:
        """Return the weight () of the angle."""
        return weight * (~self._warming_up()).float()

    def _critic_loss(self, rows: Transitions, seen: Tensor, tradeoffs: Tensor) -> Tensor:
        options, (actor, critic) = self.options, self.targets
        with torch.no_grad():
            following = self._normalized(rows.following)
            action = self._act(actor, following, tradeoffs)
            noise = options.smoothing * torch.empty_like(action).normal_(generator=self.generator)
            action = (action + noise.clamp(-options.clip, options.clip)).clamp(-1.0, 1.0)
            values = self._value(critic, following, action, tradeoffs)
            future = smaller(values, tradeoffs[:, None]).squeeze(1)
            wanted = (rows.reward + rows.discount * future)[:, None, None]
        values = self._value(self.agent.critic, seen, rows.action[:, None], tradeoffs)
        twins = values.unflatten(-1, (2, -1))
        error = smooth_l1_loss(twins, wanted.expand_as(twins))
        return 2 * (error + self._guided(options.critic_angle) * self._angle(twins, tradeoffs))

    def _actor_loss(self, seen: Tensor, tradeoffs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the loss (), and the angle () in degrees that it holds."""
        action = self._act(self.agent.actor, seen, tradeoffs)
        twins = self._value(self.agent.critic, seen, action, tradeoffs)
        value = twins.unflatten(-1, (2, -1))[..., :1, :]
        degrees = self._angle(value, tradeoffs)
        utility = (value * tradeoffs[:, None, None]).sum(-1).mean()
        return self._guided(self.options.actor_angle) * degrees - utility, degrees


LEARNER = PDMORL
