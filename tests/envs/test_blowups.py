"""A world that blows up is terminated, counted and reset, and harms no other world."""

from contextlib import closing

import numpy as np
import pytest
import torch
from crowd import Crowd
from tiny import learner as learner_of
from tiny import tiny
from torch import Tensor

from morlax_torch import MORLAX, MorlaxError, envs
from morlax_torch.configuration.config import Config
from morlax_torch.runs.progress import Progress
from morlax_torch.runs.training import Session, make_evaluator
from morlax_torch.train import train


def small(env: str = "crowd", **changes: int) -> Config:
    changes = {"max_env_steps": 320, "evaluation.every": 160, **changes}
    return tiny(env, **changes, **{"task.episode_length": 10})


def test_a_nan_action_ends_one_episode_and_no_more(crowd, backend):
    env, clean = (envs.make("crowd", 2, "cpu", backend) for _ in range(2))
    for t in range(5):
        action = torch.full((2, 1), 0.5)
        expected = clean.step(action)
        if t == 2:
            action[0] = float("nan")
        step = env.step(action)
        assert step.reward.isfinite().all() and step.observation.isfinite().all()
        assert all(term.isfinite().all() for term in step.terms.values())
        assert step.terminated.tolist() == [t == 2, False]
        assert torch.equal(step.reward[1], expected.reward[1])
    assert env.blowups == 1


def test_training_survives_a_world_with_a_huge_velocity():
    config = small("ant", worlds=64)
    env = envs.make("ant", 64, "cpu", **config.task.model_dump())
    morlax = MORLAX(env, config)
    morlax.iterate()
    env.physics.qvel[7] = 1e9
    morlax.iterate()
    scale = morlax.agent.value_normalizer.variance.clone()
    morlax.iterate()
    metrics = morlax.metrics()
    assert metrics["blowups"] == 1
    assert all(np.isfinite(value) for value in metrics.values())
    assert all(value.isfinite().all() for value in morlax.agent.state_dict().values())
    assert scale.max() < 1e6


@pytest.fixture
def unsound(crowd, monkeypatch) -> list[int]:
    """Worlds whose reward becomes NaN from a step on; the list holds the first such step."""
    begin, sound = [10**9], Crowd.terms

    def terms(self) -> dict[str, Tensor]:
        self.steps = getattr(self, "steps", 0) + 1
        named = sound(self)
        return {**named, "turn": named["turn"] * float("nan")} if self.steps > begin[0] else named

    monkeypatch.setattr(Crowd, "terms", terms)
    return begin


def test_a_run_of_which_every_evaluated_episode_blows_up_stops_with_a_reason(unsound, tmp_path):
    unsound[0] = 2
    with pytest.raises(MorlaxError, match=r"every episode blew up .* after iteration 0: .*latest"):
        train(small(), output=tmp_path / "run")


def test_a_run_of_which_every_world_blows_up_stops_with_a_reason(unsound, tmp_path):
    unsound[0] = 25  # the second of two intervals of training, each of 20 steps
    with pytest.raises(MorlaxError, match=r"every world blew up in each rollout of iterations"):
        train(small(), output=tmp_path / "run")
    assert (tmp_path / "run" / "checkpoints" / "latest.pt").exists()


def test_observations_that_are_never_finite_are_no_fault_of_the_learning_rate(
    crowd, tmp_path, monkeypatch
):
    monkeypatch.setattr(Crowd, "observe", lambda self: self.physics.qpos * float("nan"))
    quick = {"evaluation.every": None, "max_seconds": 5}  # evaluated at its end only
    with pytest.raises(MorlaxError, match=r"loss became nan .*: check the task's rewards and obs"):
        train(small(**quick), output=tmp_path / "run")


def test_blow_ups_are_counted_in_evaluations_and_metrics(crowd, tmp_path, monkeypatch):
    def terms(self) -> dict[str, Tensor]:
        speed = self.physics.qvel[:, 0].clone()
        speed[0] = float("nan")
        return {"turn": speed, "effort": self.physics.ctrl.square().sum(-1)}

    monkeypatch.setattr(Crowd, "terms", terms)
    found = []
    train(small(), output=tmp_path / "run", on_evaluation=found.append)
    assert [evaluation.blowups for evaluation in found] == [0, 20, 40]  # a step blows up one world
    assert found[0].front.blowups.tolist() == [1, 0, 0, 0]
    assert all(evaluation.indicators["blowup_rate"] == 0.25 for evaluation in found)


@pytest.mark.parametrize("kept", [1000, 0])  # by worlds that are resumed, and that start anew
def test_blow_ups_of_earlier_sessions_count(kept, crowd):
    learner = learner_of(small())
    learner.env.blowups += kept
    progress = Progress(blowups=1000)
    with closing(Session(learner, make_evaluator(learner), None, progress).training()) as found:
        assert [evaluation.blowups for evaluation in found] == [1000, 1000, 1000]
