"""Worlds made from a vectorized environment with the interface of rsl_rl."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny import TYPED, learner, tiny

from morlax_torch import MorlaxError, envs
from morlax_torch.commands.train import command as train_command
from morlax_torch.runs.training import make_evaluator

TINY = {"backend": None, "worlds": 16, "horizon": 5, "max_env_steps": 240, "task.episode_length": 8}


class Line:
    """Points that go left or right; they fail beyond -3, and time is up after 8 steps."""

    num_actions, max_episode_length = 1, 8

    def __init__(self, num_envs: int, device: torch.device, seed: int):
        self.num_envs, self.device = num_envs, device
        self.x, self.episode_length_buf = torch.zeros(2, num_envs, device=device)

    def reset(self):
        self._restart(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))
        return self.get_observations(), {}

    def get_observations(self):
        time = self.episode_length_buf / self.max_episode_length
        return {"policy": torch.stack([self.x, time], 1), "critic": self.x[:, None]}

    def step(self, actions):
        self.x = self.x + actions[:, 0]
        self.episode_length_buf = self.episode_length_buf + 1
        terms = {"go": actions[:, 0], "save": -actions[:, 0].abs(), "at": self.x.clone()}
        time_outs = self.episode_length_buf >= self.max_episode_length
        dones = (self.x < -3) | time_outs
        self._restart(dones)
        extras = {"time_outs": time_outs, "terms": terms}
        return self.get_observations(), terms["go"] + terms["save"], dones, extras

    def _restart(self, which):
        self.x = torch.where(which, 0.1 * torch.rand(self.num_envs), self.x)
        self.episode_length_buf = torch.where(which, 0.0, self.episode_length_buf)


GOALS = {"go": {"go": 1.0}, "save": {"save": 1.0}}
LineWorlds = envs.from_vecenv(
    Line,
    lambda env, extras: extras["terms"],
    GOALS,
    reference_point=(-10.0, -10.0),
    episode_length=8,
    action_scale=2.0,
)
NAME = f"{Path(__file__)}:LineWorlds"


def test_rewards_and_ends_are_those_of_the_environment():
    env = envs.make(NAME, 3, "cpu")
    assert (env.observation_size, env.privileged_size, env.action_size) == (2, 1, 1)
    pushes = torch.tensor([[1.0], [0.25], [-1.0]])
    for number in range(1, 9):
        step = env.step(pushes)
        torch.testing.assert_close(step.reward, torch.cat([2 * pushes, -2 * pushes.abs()], 1))
        assert step.terminated.tolist() == [False, False, number in (2, 4, 6, 8)]
        assert step.truncated.tolist() == [number == 8, number == 8, False]


def test_groups_of_observations_are_checked_once(monkeypatch):
    checked, task = [], envs.get(NAME)
    size = task._size
    monkeypatch.setattr(task, "_size", lambda *args: checked.append(size(*args)))
    env = envs.make(NAME, 3, "cpu")
    for _ in range(9):
        env.step(torch.ones(3, 1))
    env.reset()
    assert len(checked) == 1


def test_a_reference_point_may_be_a_list():
    task = envs.from_vecenv(Line, lambda env, extras: extras["terms"], GOALS, [-10, -10])
    envs.register("listed-line", task)
    assert learner(tiny("listed-line", **TINY)).env.reference_point == (-10.0, -10.0)


def test_a_world_that_is_over_earns_nothing_in_an_evaluation():
    env = envs.make(NAME, 2, "cpu", auto_reset=False)
    total = sum(env.step(torch.ones(2, 1)).reward for _ in range(12))
    torch.testing.assert_close(total, torch.tensor([[16.0, -16.0]] * 2))
    assert env.reset().shape == (2, 2)
    assert env.step(torch.ones(2, 1)).reward.any()


def test_a_run_masks_steps_at_a_time_limit_and_says_so(tmp_path, capsys):
    typed = *TYPED[:-4], "--max-env-steps", "320", "--output", str(tmp_path / "run")
    train_command(["--env", NAME, *typed])
    assert "steps at a time limit are left out (ppo.truncation mask)" in capsys.readouterr().out
    assert "truncation: mask" in (tmp_path / "run" / "config.yaml").read_text()
    with pytest.raises(MorlaxError, match=r"do not show how an episode ended.*mask"):
        learner(tiny(NAME, **TINY, **{"ppo.truncation": "bootstrap"}))


def ended_apart(self, actions):  # as Gymnasium's, and Isaac Lab's without its wrapper
    seen, reward, dones, extras = Line.step(self, actions)
    return seen, reward, dones, dones, extras


WRONG = [  # members of an environment, how its terms are read, and the end of the error
    ({"step": ended_apart}, None, "ValueError: too many values to unpack"),
    ({"reset": property()}, None, "has no getter"),
    ({}, lambda env, extras: None, "'NoneType' object is not iterable"),
    ({}, lambda env, extras: {"go": extras["goal"]}, f"KeyError: 'goal' ({__file__}, line "),
]


@pytest.mark.parametrize(("members", "read", "end"), WRONG)
def test_an_environment_of_another_interface_is_one_sentence(members, read, end):
    kind = type("Other", (Line,), members)
    envs.register("other-line", envs.from_vecenv(kind, read, GOALS))
    with pytest.raises(MorlaxError, match=r"step\(actions\) -> \(obs.* are needed: ") as caught:
        envs.make("other-line", 3, "cpu")
    assert end in str(caught.value) and "\n" not in str(caught.value)


def test_an_environment_that_does_not_fit_is_refused():
    def strange(number, device, seed):
        env = Line(number, device, seed)
        env.get_observations = lambda: {"image": env.x[:, None]}
        return env

    envs.register("few-lines", envs.from_vecenv(lambda n, *_: Line(2, *_), None, GOALS))
    with pytest.raises(MorlaxError, match=r"has 2 worlds on cpu, .*should be 4"):
        envs.make("few-lines", 4, "cpu")
    envs.register("strange-line", envs.from_vecenv(strange, None, GOALS))
    with pytest.raises(MorlaxError, match=r"called actor or policy, but image"):
        envs.make("strange-line", 4, "cpu")


def alone(again: bool) -> type[envs.Worlds]:
    """Return a task whose simulator exists once, as Isaac Lab's; `make_env` can return it again."""
    built: list[Line] = []

    def make(number: int, device: torch.device, seed: int) -> Line:
        if built and not again:
            raise RuntimeError("Simulation context already exists.")
        built[:] = built or [Line(number, device, seed)]
        return built[0]

    return envs.from_vecenv(make, LineWorlds.read_terms, GOALS, episode_length=8)


def test_training_and_evaluations_take_turns_in_the_only_environment():
    envs.register("only-line", alone(again=True))
    envs.register("two-lines", envs.from_vecenv(Line, LineWorlds.read_terms, GOALS, None, 8))
    fronts = [
        make_evaluator(learner(tiny(name, **TINY))).evaluate()
        for name in ("only-line", "two-lines")
    ]
    np.testing.assert_array_equal(fronts[0].returns, fronts[1].returns)


def test_episodes_start_anew_after_an_evaluation_in_the_only_environment():
    envs.register("lonely-line", alone(again=True))
    made = learner(tiny("lonely-line", **TINY))
    evaluator = make_evaluator(made)
    for _ in range(3):
        made.iterate()  # 5 steps
        time = 8 * made.rollout.observation[..., 1].flatten(1)
        assert torch.equal(time, torch.arange(5.0)[:, None].expand(5, 16))
        evaluator.evaluate()
    assert made.metrics().get("episode_length", 0) == 0  # none came to its end
    with pytest.raises(MorlaxError, match=r"have been moved by others.*reset"):
        made.env.step(torch.zeros(16, 1))


def test_a_term_that_is_not_finite_ends_the_episode_with_zero_reward():
    def terms(env, extras):
        return {**extras["terms"], "go": torch.tensor([math.nan, 1.0, 1.0])}

    envs.register("faulty-line", envs.from_vecenv(Line, terms, GOALS))
    step = envs.make("faulty-line", 3, "cpu").step(torch.ones(3, 1))
    assert step.blown_up.tolist() == step.terminated.tolist() == [True, False, False]
    assert step.reward[0].tolist() == [0, 0] and step.reward[1:].isfinite().all()
