"""One iteration: explore with the policies of K trade-offs, then learn from all that they did."""

import torch
from torch import Tensor

from ..configuration.config import Config
from ..envs import MorlaxError
from ..envs.worlds.design_space import DesignSpace, compile_bank
from ..envs.worlds.environment import Environment
from ..envs.worlds.mirror import check
from ..host.resources import one_thread
from .batch import Table, expected_returns, make_batch
from .learner import Learner
from .ppo import PPO
from .rollout import collect
from .scalarizations import make_scalarization

STARTS = 16  # first observations of episodes per trade-off, to estimate returns from


class DesignDraws:
    """Gives each of K clusters a body, for as long as an episode may last, and then another one.

    The worlds adopt a bank of `config.sampling.designs` bodies. Clusters begin at even distances in
    time, so that a few of them change in each iteration.
    """

    def __init__(self, env: Environment, config: Config):
        space, K = DesignSpace(env.designs), config.num_clusters
        self.env, self._each = env, config.worlds // K
        self.bank = compile_bank(env, space.spread(config.sampling.designs, config.seed))
        if config.network.symmetric and type(env).mirror is Environment.mirror:
            for row in {*self.bank.designs.argmin(0), *self.bank.designs.argmax(0)}:
                check(self.bank.models[row], config.network.symmetry_tolerance)
        contexts = torch.from_numpy(space.scaled(self.bank.designs)).float()
        self._contexts = contexts.to(env.device)  # (D, d)
        env.adopt(self.bank)
        self.rows = torch.zeros(K, dtype=torch.int64, device=env.device)  # of the bank
        # steps until a cluster changes its body; at first, all get one
        self.left = -(torch.arange(K, device=env.device) * env.episode_length // K)

    @property
    def context(self) -> Tensor:
        """(K, d)"""
        return self._contexts[self.rows]

    def draw(self, steps: int, generator: torch.Generator) -> Tensor:
        """Change the bodies that are due, before so many steps; returns which worlds, (N,) bool."""
        due = self.left <= 0
        drawn = torch.empty_like(self.rows).random_(0, len(self._contexts), generator=generator)
        self.rows.copy_(torch.where(due, drawn, self.rows))
        self.left.add_(torch.where(due, self.env.episode_length, 0)).sub_(steps)
        bodies, fresh = (x[:, None].expand(-1, self._each).flatten() for x in (self.rows, due))
        self.env.embody(bodies, fresh)
        return fresh


class Trainer(Learner):
    """Trains an agent with PPO. See `MORLAX`."""

    def _build(self) -> None:
        env, config = self.env, self.config
        if config.ppo.truncation == "bootstrap" and not env.shows_endings:
            raise MorlaxError(
                "these worlds do not show how an episode ended, so there is no value to bootstrap "
                "from: set ppo.truncation to mask."
            )
        self.ppo = PPO(self.agent, config.ppo, self.group)
        self.scalarization = make_scalarization(config.scalarization, env.objectives, env.device)
        self.designs: DesignDraws | None = None
        if config.sampling.designs:
            assert isinstance(env, Environment)
            self.designs = DesignDraws(env, config)
            self._process_state["design_rows"] = [self.designs.rows]
            self._process_state["design_steps"] = [self.designs.left]
            self._start_here()
        if self.scalarization.uses_returns:
            starts = self.observation.view(config.num_clusters, -1, self.observation.shape[1])
            self._starts = starts[:, :STARTS].clone()  # (K, up to STARTS, O + P)
            self._process_state["starts"] = [self._starts]
        values = env.objectives if config.ppo.critic == "vector" else ("utility",)
        self.metric_names = *PPO.metrics, *(f"explained_variance/{name}" for name in values)
        self._metrics = self.tradeoffs.new_zeros(len(self.metric_names))
        self._sums += [self._metrics, *(adam.norms for adam in self.ppo.optimizers)]
        self._state["optimizers"] = self.ppo.state()
        self._state["scalarization"] = self.scalarization.state()

    def _draw(self) -> None:
        """Draw the trade-offs (K, m) of an iteration, in place, or keep them. Runs in a graph."""

    @property
    def conditions(self) -> Tensor:
        """What the networks of K clusters depend on: trade-offs and perhaps designs (K, m + d)."""
        if self.designs is None:
            return self.tradeoffs
        return torch.cat([self.tradeoffs, self.designs.context], -1)

    def _explore(self, steps: int | None = None) -> None:
        self._draw()
        with torch.no_grad(), one_thread(self.env.device):
            if self.designs:
                fresh = self.designs.draw(self.config.horizon, self.generator)
                self._episodes.running.masked_fill_(fresh[:, None], 0.0)
                self.observation.copy_(self.env.critic_observation())
            explore = self.agent.actors(self.conditions).explore
            rollout = self.rollout.first(steps or self.config.horizon)
            collect(self.env, explore, self.observation, rollout, self.generator)

    def _weights(self) -> Tensor:
        """Return the weight (K, m) of each objective's advantage."""
        if not self.scalarization.uses_returns:
            return self.scalarization.weights(self.tradeoffs, self.tradeoffs)
        failing = self.rollout.terminated.float().mean((0, 2))
        discount, length = self.config.ppo.discount, self.env.episode_length
        returns = expected_returns(
            self.agent, self.conditions, self._starts, failing, discount, length
        )
        self.scalarization.observe(self.tradeoffs, returns, self.group)
        weights = self.scalarization.weights(self.tradeoffs, returns)
        # only the direction counts, so that no trade-off learns faster than another
        return weights / weights.abs().sum(-1, keepdim=True).clamp(min=1e-12)

    def _learn(self, rounds: int | None = None) -> None:
        """Learn from the rollout for so many epochs."""
        config, decay = self.config.ppo, self._decay()
        if self.config.decay_fraction:
            self.ppo.decay(decay)
        batch, explained = make_batch(
            self.agent, self.conditions, self.rollout, config, self._weights(), self.group
        )
        losses = torch.zeros(len(PPO.metrics), dtype=torch.float32, device=self.env.device)
        table = Table(batch)
        epochs = rounds or config.epochs
        for epoch in range(epochs):
            parts = table.minibatches(self.conditions, config.minibatches, self.generator)
            first, last = epoch == 0, epoch == epochs - 1
            losses += self.ppo.improve(parts, self.generator, first, last)
        # Only now: during the update the policies must see the inputs that they acted on. Decayed
        # too, since policies cannot follow a moving normalizer once their learning rate is zero.
        self.agent.observation_normalizer.update(self.rollout.observation, decay, self.group)
        self._count(self.rollout)
        self._metrics += torch.cat([losses / config.epochs, explained])

    def metrics(self) -> dict[str, float]:
        bodies = {"bodies": len(self.designs.bank.models)} if self.designs else {}
        return super().metrics() | bodies

    def _means(self) -> dict[str, Tensor]:
        iterations = max(1, self._iterations)
        updates = iterations * self.config.ppo.epochs * self.config.ppo.minibatches
        names = ("joint",) if self.ppo.joint else ("actor", "critic")
        optimizers = dict(zip(names, self.ppo.optimizers, strict=True))
        return {
            **dict(zip(self.metric_names, self._metrics / iterations, strict=True)),
            **super()._means(),
            **{f"learning_rate/{name}": x.rate for name, x in optimizers.items()},
            **{f"gradient_norm/{name}": x.norms / updates for name, x in optimizers.items()},
            **self.scalarization.metrics(self.env.objectives),
        }
