"""Try one trade-off under conditions that training may not have had."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from ..envs import MorlaxError
from ..envs.worlds.options import TaskOptions
from ..evaluation.evaluator import Evaluator
from ..evaluation.making import evaluation_worlds
from ..host.phases import phase
from ..networks.policy import Policy

EPISODES = 32
USUAL = "as in evaluations"
# changes of `task.randomization`, on top of the task's own
CONDITIONS: dict[str, dict[str, Any]] = {
    "other starts": {},
    "pushes of 0.5 m/s": {"push": 0.5, "push_every": 100},
    "friction times 0.5 to 1.5": {"friction": (0.5, 1.5)},
    "masses times 0.8 to 1.2": {"mass": (0.8, 1.2)},
    "motors times 0.8 to 1.2": {"strength": (0.8, 1.2)},
}
STARTS = 0.01  # least spread of starts, so that episodes differ


class Trial(NamedTuple):
    """Means over the episodes of one trade-off."""

    values: np.ndarray  # (m + q,) returns by objective, then measured quantities
    falls: float  # share of episodes that failed
    episodes: int


def trials(policy: Policy, tradeoff: Sequence[float], seed: int = 0) -> dict[str, Trial]:
    """Simulate a trade-off (m,) under several conditions, each in `EPISODES` episodes.

    Only the options of this package's own kind of robot can be changed: other tasks are simulated
    as usual. Conditions in which a task's worlds cannot differ are left out.

    Args:
        policy: simulated on its device.
        tradeoff: not negative.
        seed: random seed of the worlds.
    """
    task = policy.config.task.for_evaluation()
    tried = {USUAL: task}
    if isinstance(task, TaskOptions):
        for name, changes in CONDITIONS.items():
            varied = task.randomization.model_copy(update=changes)
            update = {"randomization": varied, "reset_noise": max(task.reset_noise, STARTS)}
            tried[name] = task.model_copy(update=update)
    found: dict[str, Trial] = {}
    for number, (name, options) in enumerate(tried.items()):
        phase("trying other conditions", number / len(tried))
        try:
            found[name] = _trial(policy, options, tradeoff, seed)
        except MorlaxError:  # worlds of this task cannot differ in this
            if name == USUAL:
                raise
    return found


def _trial(policy: Policy, task: Any, tradeoff: Sequence[float], seed: int) -> Trial:
    place = str(policy.agent.observation_normalizer.mean.device)
    config = policy.config.model_copy(update={"task": task, "device": place, "backend": None})
    episodes = EPISODES if task.varies else 1
    env = evaluation_worlds(config, 1, episodes, seed)
    points = torch.tensor([tradeoff], dtype=torch.float32)
    protocol = config.evaluation.protocol
    front = Evaluator(policy.agent, env, points, protocol, seed, episodes, alone=True).evaluate()
    falls = 0.0 if front.falls is None else float(front.falls[0])
    return Trial(front.values[0], falls, episodes)
