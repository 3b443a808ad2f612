"""Random configs and files: each is accepted and works, or is refused in one sentence.

CI tries a few of each. To try them for half an hour each, two at a time:

    python -m pytest tests/commands/test_fuzz.py --fuzz-minutes 30 -n 2 -s
"""

import contextlib
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis
import numpy as np
import pytest
import torch
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiny import learner as learner_of
from tiny import tiny

from morlax_torch import MorlaxError, config_for, envs, load
from morlax_torch.configuration.config import load_config
from morlax_torch.evaluation.front import Front
from morlax_torch.runs.progress import History
from morlax_torch.runs.training import Session, make_evaluator
from morlax_torch.train import train

HANG = 30.0  # seconds

Fuzz = Callable[[Callable[[Any], None], st.SearchStrategy, int], None]


@pytest.fixture
def fuzz(request: pytest.FixtureRequest) -> Fuzz:
    """Return a function that tries a property on `few` drawn values, or for --fuzz-minutes."""
    minutes = request.config.getoption("--fuzz-minutes")

    def run(holds: Callable[[Any], None], values: st.SearchStrategy, few: int) -> None:
        tried, started = 0, time.monotonic()

        def timed(value: Any) -> None:
            nonlocal tried
            tried += 1
            begun = time.monotonic()
            holds(value)
            assert time.monotonic() - begun < HANG, "it hung"

        unhurried = settings(
            max_examples=few, deadline=None, database=None, suppress_health_check=list(HealthCheck)
        )
        attempt = unhurried(given(values)(timed))
        if not minutes:
            hypothesis.seed(0)(attempt)()
            return
        while time.monotonic() - started < 60 * minutes:
            hypothesis.seed(time.time_ns())(attempt)()
        print(f"\n{request.node.name}: {tried} values in {minutes:g} minutes, none failed")

    return run


@contextlib.contextmanager
def one_sentence():
    """Let a MorlaxError pass if it is something that a user can read."""
    try:
        yield
    except MorlaxError as error:
        text = str(error)
        assert "\n" not in text and 10 < len(text) < 3000, text


TASKS = [name for name in envs.names() if "/" not in name]
ODD = st.one_of(
    st.floats(),
    st.integers(-(2**70), 2**70),
    st.text(max_size=5),
    st.none(),
    st.booleans(),
    st.lists(st.integers(-1, 3), max_size=3),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)
WEIGHT = st.floats(-1e9, 1e9)
SHARE = st.floats(0, 1)
LAYERS = st.lists(st.integers(1, 32), max_size=3).map(tuple)
FACTORS = st.tuples(st.floats(0.01, 1), st.floats(1, 100))
USUAL: dict[str, st.SearchStrategy] = {
    "seed": st.integers(0, 2**63 - 1),
    "worlds": st.sampled_from((8, 16, 24, 32)),
    "horizon": st.integers(1, 8),
    "sampling.mode": st.sampled_from(("sparse", "dense")),
    "sampling.clusters": st.sampled_from((2, 4, 8)),
    "sampling.corners": st.sampled_from((None, 0, 2)),
    "sampling.alpha": st.floats(1e-3, 1e6),
    "sampling.cells": st.booleans(),
    "network.type": st.sampled_from(("dual", "single", "conditioned")),
    "network.hidden": LAYERS,
    "network.features": st.integers(1, 16),
    "network.actor": LAYERS,
    "network.critic": LAYERS,
    "network.initial_std": st.floats(0.0011, 100),
    "network.output_scale": st.floats(0, 100),
    "ppo.learning_rate": st.floats(1e-12, 1e-2),
    "decay_fraction": st.floats(0, 1),
    "ppo.desired_kl": st.sampled_from((None, 1e-4, 0.01, 1.0)),
    "ppo.epochs": st.integers(1, 3),
    "ppo.minibatches": st.sampled_from((1, 2, 4)),
    "ppo.discount": SHARE,
    "ppo.gae_lambda": SHARE,
    "ppo.clip": st.floats(1e-6, 100),
    "ppo.entropy": st.floats(0, 10),
    "ppo.mean_penalty": st.floats(0, 10),
    "ppo.truncation": st.sampled_from(("bootstrap", "mask")),
    "task.episode_length": st.integers(1, 40),
    "task.reset_noise": st.floats(0, 0.5),
    "task.stagger": st.booleans(),
    "task.solver_iterations": st.integers(1, 100),
    "task.randomization.friction": FACTORS,
    "task.randomization.mass": FACTORS,
    "task.randomization.strength": FACTORS,
    "task.randomization.fields": st.just({"dof_damping": (0.5, 2.0)}),
    "task.randomization.action_delay": st.sampled_from(((0, 0), (0, 2), (3, 3))),
    "task.randomization.push": st.floats(0, 5),
    "task.randomization.push_every": st.integers(1, 100),
}
NAMES = st.text(st.sampled_from("abcXYZ019_ -=+$[]{}\\/<>\"'é\n\0"), min_size=1, max_size=45)


@st.composite
def configs(draw: st.DrawFn) -> tuple[str, dict[str, Any]]:
    """A task, and changes to its config: usual ones and, in a third of the cases, odd ones."""
    env = draw(st.sampled_from(TASKS))
    names = draw(st.lists(st.sampled_from(sorted(USUAL)), unique=True, max_size=12))
    changes = {name: draw(USUAL[name]) for name in names}
    if draw(st.booleans()):
        objectives = draw(st.lists(NAMES, unique=True, min_size=2, max_size=4))
        usual = envs.get(env).Options().objectives.values()
        terms = sorted({term for weights in usual for term in weights})
        weights = st.dictionaries(st.sampled_from(terms), WEIGHT, max_size=2)
        changes["task.objectives"] = {name: draw(weights) for name in objectives}
    if draw(st.integers(0, 2)) == 0:
        changes[draw(st.sampled_from([*sorted(USUAL), "task.reference_point", "x"]))] = draw(ODD)
    return env, changes


def trains_or_is_refused(drawn: tuple[str, dict[str, Any]]) -> None:
    env, changes = drawn
    small = {"worlds": 16, "horizon": 4, "sampling.clusters": 4, "ppo.minibatches": 2}
    fixed = {"device": "cpu", "backend": "mujoco", "max_env_steps": 10**6}
    with one_sentence():
        config = config_for(env, **{**small, **changes, **fixed, "evaluation.tradeoffs": 8})
        assert load_config(yaml.safe_load(yaml.safe_dump(config.model_dump(mode="json")))) == config
        # odd values may make valid configs too large to train here
        layers = (*config.network.hidden, *config.network.actor, *config.network.critic)
        sizes = (config.worlds, config.horizon, config.ppo.epochs, config.network.features)
        hypothesis.assume(max(*sizes, *layers) <= 128 and config.task.episode_length <= 500)
        learner = learner_of(config)
        limit = {"max_env_steps": 2 * learner.steps_per_iteration, "max_seconds": None}
        learner.config = config.model_copy(update=limit)
        for evaluation in Session(learner, make_evaluator(learner)).training():
            assert np.isfinite(evaluation.front.returns).all()
            numbers = evaluation.row().items() - {("protocol", evaluation.front.protocol)}
            assert all(math.isfinite(value) for _, value in numbers)
        assert all(math.isfinite(value) for value in learner.metrics().values())
        assert all(value.isfinite().all() for value in learner.agent.state_dict().values())


@pytest.mark.slow
def test_a_random_config_trains_or_is_refused(fuzz):
    fuzz(trains_or_is_refused, configs(), 4)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    return train(tiny(max_env_steps=96), output=tmp_path_factory.mktemp("fuzz") / "run").folder


class Damage(NamedTuple):
    """Bytes of a file that are flipped, cut out and inserted."""

    flips: list[tuple[int, int]]  # a position, and the bits to flip there
    start: int
    length: int
    new: bytes

    def __call__(self, data: bytes) -> bytes:
        changed = bytearray(data)
        for at, bits in self.flips:
            changed[at] ^= bits
        return bytes(changed[: self.start] + self.new + changed[self.start + self.length :])


def damages(size: int) -> st.SearchStrategy[Damage]:
    return st.builds(
        Damage,
        st.lists(st.tuples(st.integers(0, size - 1), st.integers(1, 255)), max_size=8),
        st.integers(0, size),
        st.sampled_from((0, 0, 1, 10, size)),
        st.sampled_from((b"", b"", b"\0", b"PK\3\4", b"nan", b"\xff" * 20)),
    )


def test_a_damaged_checkpoint_gives_an_equal_policy_or_is_refused(fuzz, run, tmp_path):
    whole = (run / "checkpoints" / "best.pt").read_bytes()
    expected, file = load(run).agent.state_dict(), tmp_path / "damaged.pt"

    def holds(damage: Damage) -> None:
        file.write_bytes(damage(whole))
        with one_sentence():
            found = load(file).agent.state_dict()
            assert all(torch.equal(found[name], value) for name, value in expected.items())

    fuzz(holds, damages(len(whole)), 100)


@pytest.mark.parametrize("name", ["metrics.csv", "front.npz"])
def test_a_damaged_result_is_finite_or_refused(fuzz, name, run, tmp_path):
    whole, file = (run / name).read_bytes(), tmp_path / name

    def holds(damage: Damage) -> None:
        file.write_bytes(damage(whole))
        with one_sentence():
            found = History.load(file) if name == "metrics.csv" else Front.load(file)
            numbers = [value for value in found if isinstance(value, np.ndarray)]
            assert numbers and all(np.isfinite(values).all() for values in numbers)

    fuzz(holds, damages(len(whole)), 200)
