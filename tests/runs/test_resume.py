"""A resumed run continues exactly, on any simulator, and evaluations repeat themselves."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import tiny as small
import torch
from crowd import Crowd
from same import assert_same, rows_of
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.summary.writer import event_file_writer
from tiny import learner as trainer
from torch import Tensor, nn

from morlax_torch import envs
from morlax_torch.configuration.config import Config
from morlax_torch.envs.devices import restore_generator
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import Run, checkpoint
from morlax_torch.runs.progress import Evaluation, Progress, best_row, kept_fronts
from morlax_torch.runs.training import make_evaluator
from morlax_torch.train import train

CASES: dict[str, dict[str, Any]] = {
    "hopper": {"decay_fraction": 0.5, "max_env_steps": 224},
    "ant": {"task.reset_noise": 0.01},
    "humanoid": {"task.stagger": True},
    "design/hopper": {"sampling.designs": 8, "task.episode_length": 20},
    "bruce": {"task.draw_commands": True, "task.noise": 1.0, "task.randomize": True},
    f"{small.__file__}:Blind": {},
}


def tiny(env: str = "hopper", **changes: Any) -> Config:
    more = {"sampling.clusters": 8, "evaluation.tradeoffs": 8, "decay_fraction": 0.0}
    return small.tiny(env, **{**more, **changes})


@pytest.mark.parametrize(
    ("env", "networks"),
    [*((env, dict) for env in CASES), ("hopper", lambda: {"actor": nn.Linear(13, 8)})],
    ids=[*(env.rpartition(":")[2] for env in CASES), "own network"],
)
def test_iterations_after_a_resume_equal_uninterrupted_ones(env, networks, tmp_path):
    config, path = tiny(env, **CASES[env]), tmp_path / "half.pt"
    whole = trainer(config, 3, **networks())
    checkpoint.write(path, checkpoint.snapshot(whole), Progress())
    resumed = trainer(config, 0, **networks())  # like those given, with other parameters
    checkpoint.restore(checkpoint.load(path), path, resumed)
    for _ in range(3):
        whole.iterate()
        resumed.iterate()
    assert_same(whole.state_dict(), resumed.state_dict())


def test_a_resumed_run_ends_like_an_uninterrupted_one(tmp_path):
    """The evaluations too, although the resumed half has made fewer of them."""
    changes = {"task.reset_noise": 0.05, "evaluation.every": 64}
    whole = train(tiny(max_env_steps=128, **changes), output=tmp_path / "whole")
    train(tiny(max_env_steps=64, **changes), output=tmp_path / "halves")
    run = Run.open(tmp_path / "halves")
    halves = train(tiny(max_env_steps=128, **changes), run)
    for name in ("latest", "best"):
        one, other = (checkpoint.load(r.checkpoints / f"{name}.pt") for r in (whole, halves))
        assert_same(one.learner, other.learner)
    indicators = ("iteration", "env_steps", "hypervolume", "sparsity", "cardinality")
    assert [[row[name] for name in indicators] for row in rows_of(whole)] == [
        [row[name] for name in indicators] for row in rows_of(halves)
    ]


def test_every_training_seed_is_evaluated_in_the_same_worlds_that_training_never_sees():
    noisy = {"task.reset_noise": 0.05, "task.randomization.friction": (0.5, 1.5)}
    found = []
    for seed in (0, 1):
        learner = trainer(tiny("cheetah", worlds=16, seed=seed, **noisy), 0)
        env = make_evaluator(learner).env
        env.reset()
        found.append((env.physics.qpos.clone(), env.state_dict()["model.geom_friction"]))
        training = learner.env.state_dict()["model.geom_friction"][: env.num_worlds]
        assert not torch.isclose(training, found[-1][1]).all(-1).all(-1).any()
        assert not torch.isclose(learner.env.starts.states[0], env.starts.states[0]).all(-1).any()
    assert_same(list(found[0]), list(found[1]))


def test_a_run_moves_between_simulators_whose_state_differs(tmp_path):
    path = tmp_path / "half.pt"
    checkpoint.write(path, checkpoint.snapshot(trainer(tiny("bruce"), 2)), Progress())
    for backend in ("warp", "mujoco"):
        resumed = trainer(tiny("bruce").model_copy(update={"backend": backend}), 0)
        checkpoint.restore(checkpoint.load(path), path, resumed)
        stored = checkpoint.load(path).learner["environment"]["qpos"]
        torch.testing.assert_close(resumed.env.physics.qpos.double(), stored.double())
        resumed.iterate()
        assert all(v.isfinite().all() for v in resumed.agent.state_dict().values())
        checkpoint.write(path, checkpoint.snapshot(resumed), Progress())


def test_a_generators_state_of_another_device_becomes_its_seed():
    cuda_state = torch.arange(16, dtype=torch.uint8)
    draws = []
    for _ in range(2):
        generator = torch.Generator()
        restore_generator(generator, cuda_state)
        draws.append(torch.rand(4, generator=generator))
    assert torch.equal(*draws)
    assert not torch.equal(draws[0], torch.rand(4, generator=torch.Generator()))


# A task's own tensors


class Arm(Crowd):
    """An arm that sees a goal of each episode, which it declares or keeps silently."""

    declared = True

    class Options(Crowd.Options):
        episode_length: int = 5

    def __init__(self, physics, *args):
        self.goal = torch.zeros(physics.num_worlds, 1)
        self.scale = torch.ones(physics.num_worlds, 1)  # a constant
        self.legs = physics.qpos[:, -1:]  # a view of state that is saved
        super().__init__(physics, *args)

    def initial_state(self) -> dict[str, Tensor]:
        return {"goal": self.goal} if self.declared else {}

    def begin(self, fresh: Tensor) -> None:
        drawn = self.draws.uniform_(torch.empty_like(self.goal))
        self.goal.copy_(torch.where(fresh[:, None], self.goal + drawn, self.goal))

    def observe(self) -> Tensor:
        return torch.cat([self.legs, super().observe(), self.goal], -1).float()


@pytest.fixture
def make_arms() -> Callable[[], Arm]:
    envs.register("arm", Arm)
    return lambda: envs.make("arm", 3, "cpu", "mujoco")


def test_own_tensors_are_reset_and_resume_exactly(make_arms):
    env, other = make_arms(), make_arms()
    action = torch.ones(3, 1)
    for step in range(12):
        saved = env.state_dict()
        other.reset()
        other.load_state_dict(saved)
        then = env.step(action)
        assert_same(other.step(action)._asdict(), then._asdict())
        assert ((env.goal > 0) & (env.goal < 1)).all(), step  # not of former episodes
    assert len(env.goal.unique()) == 3


def test_undeclared_tensors_are_noticed_once(make_arms, monkeypatch):
    monkeypatch.setattr(Arm, "declared", False)
    env = make_arms()
    sentence = r"^Arm changes goal, .* resumed run will differ: .* initial_state\(\)"
    with pytest.warns(UserWarning, match=sentence) as warned:
        env.state_dict()
        env.step(torch.ones(3, 1))
        env.state_dict()
    assert len(warned) == 1


ROBOTS = [name for name in envs.names() if issubclass(envs.get(name), envs.Environment)]


@pytest.mark.parametrize("task", ROBOTS)
def test_shipped_tasks_keep_nothing_unsaved(task):
    env = envs.make(task, 3, "cpu", "mujoco", episode_length=2)
    for _ in range(3):
        env.state_dict()
        env.step(torch.rand(3, env.action_size))


class Killed(BaseException):
    """Ends training between two writes, as a kill does."""


VOLUMES = (2.0, 3.0, 1.0)  # hypervolume by iteration
SLOW = [pytest.param(n, marks=pytest.mark.slow) for n in (4, *range(6, 17))]


@pytest.mark.parametrize("writes", [5, *SLOW])
def test_a_kill_between_any_two_writes_leaves_the_best_checkpoint_with_its_row(
    writes, tmp_path, monkeypatch
):
    """Of 16 writes: the run's three files, its folder, and six for each of two evaluations.

    The resumed run evaluates only at its end, which is not the best.
    """
    usual, left = Path.replace, writes

    def counted(file: Path, target: Path) -> Path:
        nonlocal left
        left -= 1
        if left < 0:
            raise Killed
        return usual(file, target)

    volume = property(lambda evaluation: VOLUMES[evaluation.iteration])
    monkeypatch.setattr(Evaluation, "selection_hypervolume", volume)
    # TensorBoard sorts a second's files by name, a process's tenth before its ninth
    monkeypatch.setattr(event_file_writer, "_global_uid", event_file_writer.AtomicCounter(10))
    with monkeypatch.context() as patch, suppress(Killed):
        patch.setattr(Path, "replace", counted)
        train(tiny(**{"max_env_steps": 32, "evaluation.every": 32}), output=tmp_path / "run")
    assert (left < 0) == (writes < 16)
    run = train(tiny(**{"evaluation.every": 4096}), Run.open(tmp_path / "run"))
    table, best = rows_of(run), checkpoint.load(run.checkpoints / "best.pt")
    numbers = [int(row["iteration"]) for row in table]
    assert numbers in ([0, 2], [0, 1, 2])
    assert sorted(int(file.stem) for file in kept_fronts(run.folder)) == numbers
    assert len(list(run.fronts.iterdir())) == len(numbers)
    best_number = max(numbers, key=VOLUMES.__getitem__)
    assert int(table[best_row(table)]["iteration"]) == best_number == best.learner["iteration"]
    front = Front.load(run.folder / "front.npz")
    assert front.checkpoint == "best.pt"
    assert front.fingerprint == checkpoint.fingerprint(best.agent)
    shown = EventAccumulator(str(run.folder)).Reload().Scalars("front/hypervolume")
    assert [event.step for event in shown] == [int(row["env_steps"]) for row in table]
