"""NSGA-II over the parameters of policies, without gradients, to compare with.

compare.py trains it, see compare_methods.yaml. The algorithm (Deb et al., 2002) is that of EvoX,
https://github.com/EMI-Group/evox (`pip install evox`, licensed under the GPL). Every generation
runs one episode of each policy.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from evox.algorithms import NSGA2 as Evolution
from torch import Tensor

from morlax_torch import envs
from morlax_torch.algorithms.learner import make_agent
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.tradeoffs import even_tradeoffs
from morlax_torch.envs import Worlds
from morlax_torch.evaluation.evaluator import Evaluator
from morlax_torch.gpu.group import ALONE
from morlax_torch.runs import Run
from morlax_torch.runs.progress import Evaluation
from morlax_torch.runs.training import Session, make_evaluator

SMALLEST, LARGEST = -1.0, 1.0  # parameter of a policy
SEEN = 50  # random steps that observations are normalized by
SEED = 2  # of episodes; evaluations have 0


class NSGA2:
    """A `Learner` whose iteration is a generation of K policies.

    A trade-off gets the policy of the population with the largest weighted return.

    Args:
        env: K worlds, whose random steps normalize observations.
        config: with algorithm independent, and K worlds and clusters.
    """

    def __init__(self, env: Worlds, config: Config):
        self.env, self.config = env, config
        m = len(env.objectives)
        self.agent = make_agent(env, config)
        self._tried = make_agent(env, config)
        self._tried.observation_normalizer = self.agent.observation_normalizer
        self._evaluator = Evaluator(
            self._tried,
            envs.make(
                config.env,
                config.worlds,
                config.device,
                config.backend,
                SEED,
                auto_reset=False,
                **config.task.for_evaluation().model_dump(),
            ),
            even_tradeoffs(config.worlds, m),  # of which the k-th gets the k-th policy
            seed=SEED,
        )
        self.iteration = self.env_steps = 0
        self.group, self.per_process = ALONE, ()
        self.steps_per_iteration = config.worlds * self._evaluator.env.episode_length
        torch.manual_seed(config.seed)  # EvoX draws from the default generator
        bounds = torch.ones(self.agent.actor.rows.shape[1], device=env.device)
        self._evolution = Evolution(
            config.worlds, m, SMALLEST * bounds, LARGEST * bounds, device=env.device
        )
        self._evolution.evaluate = self._costs

    def compile(self) -> None:
        self._evaluator.compile()
        self._look_around()

    def iterate(self, done: float = 0.0) -> None:
        if self.iteration == 0:
            self._evolution.init_step()
        else:
            self._evolution.step()
        self.iteration += 1
        self.env_steps += self.steps_per_iteration
        actor = self.agent.actor
        with torch.no_grad():
            actor.rows.copy_(self._evolution.pop)
            actor.keys.copy_(-self._evolution.fit)
            actor.offsets.zero_()

    def metrics(self) -> dict[str, float]:
        best = (-self._evolution.fit).amax(0).tolist()
        named = {
            f"best_return/{name}": x for name, x in zip(self.env.objectives, best, strict=True)
        }
        return {**named, "blowups": 0.0, "overflow": 0.0}

    def state_dict(self) -> dict[str, Any]:
        agent = {name: x.clone() for name, x in self.agent.state_dict().items()}
        return {"agent": agent, "iteration": self.iteration}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        raise NotImplementedError("runs of this benchmark cannot be resumed")

    def _costs(self, population: Tensor) -> Tensor:
        """Return the negative returns (K, m) of policies with parameters (K, P)."""
        with torch.no_grad():
            self._tried.actor.rows.copy_(population)
        returns = self._evaluator.evaluate().returns
        return -torch.from_numpy(returns).to(population)

    def _look_around(self) -> None:
        """Normalize observations by those of random actions."""
        self.env.reset()
        generator = torch.Generator(self.env.device).manual_seed(self.config.seed)
        shape = self.env.num_worlds, self.env.action_size
        for _ in range(SEEN):
            action = torch.empty(shape, device=self.env.device).uniform_(-1, 1, generator=generator)
            self.agent.observation_normalizer.update(self.env.step(action).critic_observation)


def train(
    config: Config,
    output: Path | None = None,
    on_evaluation: Callable[[Evaluation], None] | None = None,
) -> Run:
    """Train until a limit of the config is reached; returns the run."""
    learner = NSGA2(config.make_worlds(config.worlds, config.seed), config)
    run = Run.create(learner, output)
    for evaluation in Session(learner, make_evaluator(learner), run).training():
        if on_evaluation is not None:
            on_evaluation(evaluation)
    return run
