"""Any subclass of `Worlds` can be trained in, recordable and resumable or not."""

from pathlib import Path

import pytest
import torch
from closed_form import Sprint
from peers import check_run
from tiny import learner, tiny
from torch import Tensor

from morlax_torch import MorlaxError, envs
from morlax_torch.commands import explore, export
from morlax_torch.runs.training import make_evaluator


class Points(Sprint):
    """Points of a simulator of their own, which draws where they start."""

    class Options(Sprint.Options):
        reference_point: tuple[float, ...] | None = (-10.0, -10.0)
        episode_length: int = 8

    simulator, resumable = "points", False

    def restart(self, which: Tensor) -> Tensor:
        start = torch.rand(self.num_worlds, generator=self.generator, device=self.device)
        self.x = torch.where(which, 0.1 * start, self.x)  # rebinds: a CUDA graph would not see it
        self.age = torch.where(which, 0.0, self.age)
        return self.critic_observation()


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
    assert (front.lengths == 10).all()
    assert abs(front.returns[:, 0]).max() > 0


def test_their_run_is_evaluated_and_resumed_in_new_worlds(tmp_path, capsys):
    check_run(tiny(POINTS, backend=None), tmp_path / "run", capsys)
    run = str(tmp_path / "run")
    for use in (lambda: export.command([run]), lambda: explore.command([run])):
        with pytest.raises(MorlaxError, match=r"has no MuJoCo robot, so it cannot be shown"):
            use()


class Reversed(Points):
    """Points whose reward terms come in another order than they are declared in."""

    def combine(self, terms: dict[str, Tensor]) -> Tensor:
        return super().combine(dict(reversed(terms.items())))


class Alternating(envs.get("cheetah")):
    """A cheetah whose reward terms come in another order in every other step."""

    def terms(self) -> dict[str, Tensor]:
        terms, self.odd = super().terms(), not getattr(self, "odd", False)
        return dict(reversed(terms.items())) if self.odd else terms


@pytest.mark.parametrize(("task", "other"), [(POINTS, Reversed), ("cheetah", Alternating)])
def test_reward_terms_may_come_in_any_order(task, other):
    plain, env = (envs.make(name, 3, "cpu") for name in (task, f"{__file__}:{other.__name__}"))
    for worlds in (plain, env):
        worlds.reseed(1)
        worlds.reset()
    for _ in range(3):
        action = torch.rand(3, env.action_size)
        mine, expected = env.step(action), plain.step(action)
        assert torch.equal(mine.reward, expected.reward)
        assert all(torch.equal(mine.terms[name], value) for name, value in expected.terms.items())
    with pytest.raises(MorlaxError, match="reward terms are speed, but must be "):
        env._columns({"speed": torch.ones(3)})


@pytest.mark.parametrize(
    ("name", "wrong", "needed"),
    [
        ("reward", lambda x: x[:, :1], "(3, 2) of torch.float32"),
        ("reward", lambda x: x.double(), "(3, 2) of torch.float32"),
        ("terminated", lambda x: x[:, None], "(3,) of torch.bool"),
        ("truncated", lambda x: x.float(), "(3,) of torch.bool"),
        ("final_observation", lambda x: x[0], "(3, 2) of torch.float32"),
        ("critic_observation", lambda x: None, "(3, 2) of torch.float32"),
    ],
)
def test_steps_of_other_sizes_than_declared_are_refused(name, wrong, needed):
    class Wrong(Points):
        def step(self, action: Tensor) -> envs.TimeStep:
            step = super().step(action)
            return step._replace(**{name: wrong(getattr(step, name))})

    class Mended(Wrong):
        def step(self, action: Tensor) -> envs.TimeStep:
            return super().step(action)._replace(**{name: right})

    def built(task: type[Points]) -> Points:
        return task(task.Options(), 3, torch.device("cpu"), 0, True)

    right, action = getattr(built(Points).step(torch.zeros(3, 1)), name), torch.zeros(3, 1)
    with pytest.raises(MorlaxError, match=rf"Wrong.step\(\).{name} has .*must be a ten") as caught:
        built(Wrong).step(action)
    assert needed in str(caught.value)
    assert getattr(built(Mended).step(action), name) is right
    Wrong.observation_size = 3
    with pytest.raises(MorlaxError, match=r"critic_observation\(\) has .* tensor \(3, 3\), as dec"):
        built(Wrong).reset()


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
