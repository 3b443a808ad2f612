"""Any subclass of `Worlds` can be trained in, recordable and resumable or not."""

from pathlib import Path

import pytest
import torch
from closed_form import OneStep
from peers import check_run
from tiny import learner, tiny
from torch import Tensor

from morlax_torch import MorlaxError, envs
from morlax_torch.commands import explore, export
from morlax_torch.runs.training import make_evaluator


class Points(OneStep):
    """Points on a line, of a simulator of their own: go right, or stand still."""

    class Options(envs.ObjectiveOptions):
        objectives: dict[str, dict[str, float]] = {"go": {"go": 1.0}, "save": {"save": 1.0}}
        reference_point: tuple[float, ...] | None = (-10.0, -10.0)
        episode_length: int = 8

    simulator, resumable = "points", False
    observation_size, action_size = 2, 1
    reward_terms = ("go", "save")

    def __init__(self, options, num_worlds, device, *others):
        super().__init__(options, num_worlds, device, *others)
        self.episode_length = options.episode_length
        self.x, self.age = torch.zeros(2, num_worlds, device=device)

    def reset(self) -> Tensor:
        return self.restart(torch.ones(self.num_worlds, dtype=torch.bool, device=self.device))

    def restart(self, which: Tensor) -> Tensor:
        start = torch.rand(self.num_worlds, generator=self.generator, device=self.device)
        self.x = torch.where(which, 0.1 * start, self.x)  # rebinds: a CUDA graph would not see it
        self.age = torch.where(which, 0.0, self.age)
        return self.critic_observation()

    def step(self, action: Tensor) -> envs.TimeStep:
        move = action[:, 0].clamp(-1, 1)
        self.x, self.age = self.x + move, self.age + 1
        terms = {"go": move, "save": -move.abs()}
        final = self.critic_observation()
        terminated = self.x < -3
        truncated = (self.age >= self.episode_length) & ~terminated
        if self.auto_reset:
            self.restart(terminated | truncated)
        seen = self.critic_observation()
        reward = self.combine(terms)
        return envs.TimeStep(seen, reward, terminated, truncated, final, terms, seen, final)

    def critic_observation(self) -> Tensor:
        return torch.stack([self.x, self.age / self.episode_length], -1)


POINTS = f"{Path(__file__)}:Points"


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_they_are_explored_and_evaluated_eagerly(device):
    made = learner(tiny(POINTS, backend=None, device=device))
    evaluator = make_evaluator(made)
    made.compile()
    evaluator.compile()
    before = made.agent.actor.bias.clone()
    for _ in range(3):
        made.iterate()
    assert not torch.equal(made.agent.actor.bias, before)
    assert made.env.x.abs().max() > 0.1
    front = evaluator.evaluate()
    assert (front.lengths == 5).all()
    assert abs(front.returns[:, 0]).max() > 0


def test_their_run_is_evaluated_and_resumed_in_new_worlds(tmp_path, capsys):
    check_run(tiny(POINTS, backend=None), tmp_path / "run", capsys)
    run = str(tmp_path / "run")
    for use in (lambda: export.command([run]), lambda: explore.command([run])):
        with pytest.raises(MorlaxError, match=r"has no MuJoCo robot, so it cannot be shown"):
            use()


@pytest.mark.parametrize("name", [POINTS, "cheetah", "bruce"])
def test_a_step_keeps_no_graph_of_the_actions(name, backend):
    task = envs.get(name)
    kind = {"auto_reset": True, "deterministic": False}
    env = task.build(task.Options(), 2, torch.device("cpu"), backend, 0, **kind)
    policy = torch.nn.Linear(env.observation_size, env.action_size)
    observation = env.reset()
    for _ in range(3):
        step = env.step(action=policy(observation).tanh())
        observation = step.observation
        seen = [*step.terms.values(), env.critic_observation(), *env.state_dict().values()]
        for value in (*step._replace(terms=None, blown_up=None), *seen):
            assert value is None or not value.requires_grad
    assert torch.is_grad_enabled()
