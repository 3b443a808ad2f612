"""Shared fixtures: generators, random agents and rollouts, untrained policies and runs."""

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from crowd import Bowling, Crowd

from morlax_torch import MorlaxError, Policy, envs, save
from morlax_torch.algorithms.rollout import Rollout
from morlax_torch.commands.terminal import cli
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import merged, task_values
from morlax_torch.configuration.sections import OPTIONS, NetworkConfig
from morlax_torch.evaluation.front import Front
from morlax_torch.host.resources import one_thread
from morlax_torch.networks.agent import Agent
from morlax_torch.runs.checkpoint import Task, fingerprint
from morlax_torch.viewers.filming.rendering import choose_opengl

if not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")  # Triton reads it when it is imported

with suppress(ImportError):
    import triton  # noqa: F401  its LLVM crashes if it is loaded after the one of Mesa's OpenGL

# a shell that runs the tests in the background, or nohup; subprocesses would ignore them too
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

if "PYTEST_XDIST_WORKER" in os.environ:  # workers share the cores, and so do their subprocesses
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    torch.set_num_threads(1)


def pytest_addoption(parser: pytest.Parser, pluginmanager: pytest.PytestPluginManager) -> None:
    pluginmanager.import_plugin("outcomes")  # brings further options
    about = "try random values for this long in each fuzzer, instead of a few of them"
    parser.addoption("--fuzz-minutes", type=float, default=0.0, help=about)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("gpu") and not torch.cuda.is_available():
        pytest.skip("no CUDA device")


@pytest.fixture(autouse=True)
def independent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the same numbers and know the same tasks whichever tests ran before."""
    torch.manual_seed(0)
    np.random.seed(0)
    monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))


@pytest.fixture
def dtypes() -> Iterator[Iterator[torch.dtype]]:
    """Iterate over torch's default dtypes, each of which is set meanwhile, with a device."""

    def each() -> Iterator[torch.dtype]:
        for dtype, device in ((torch.float32, "cpu"), (torch.float64, "meta")):
            torch.set_default_dtype(dtype)
            torch.set_default_device(device)
            yield dtype

    yield each()
    torch.set_default_dtype(torch.float32)
    torch.set_default_device(None)


def pytest_collection_finish() -> None:
    """Keep what was imported out of garbage collections, of which every training starts some."""
    gc.collect()
    gc.freeze()


def pytest_unconfigure() -> None:
    gc.unfreeze()


class Drawing:
    """Whether figures are drawn: that takes most of the time of a short training or evaluation."""

    wanted = False


@pytest.fixture
def rendered(monkeypatch) -> None:
    """Draw figures and robots in this test, which others leave empty."""
    monkeypatch.setattr(Drawing, "wanted", True)


@pytest.fixture(scope="session", autouse=True)
def undrawn() -> Iterator[None]:
    """Write figures without drawing them, except in tests that are `rendered`."""
    from matplotlib.figure import Figure

    from morlax_torch.evaluation import figures
    from morlax_torch.viewers.filming import recording

    savefig, pixels, portrait = Figure.savefig, figures.pixels, recording.portrait
    empty = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<svg></svg>"}

    def save(figure: Figure, file: Any, *args: Any, **options: Any) -> None:
        kind = options.get("format")
        if Drawing.wanted or kind not in empty:
            savefig(figure, file, *args, **options)
        else:
            file.write(empty[kind] if "b" in getattr(file, "mode", "b") else empty[kind].decode())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        nothing = np.zeros((2, 2, 3), np.uint8)
        patch.setattr(figures, "pixels", lambda x: pixels(x) if Drawing.wanted else nothing)
        patch.setattr(recording, "portrait", lambda x: portrait(x) if Drawing.wanted else None)
        yield


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.fixture(params=("mujoco", "warp"))
def backend(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a new folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents() -> dict[Path, int]:
    """Return what is in the working directory, with times of files; nothing of the checkout."""
    paths = [] if Path.cwd() in Path(__file__).parents else Path.cwd().rglob("*")
    return {path: path.stat().st_mtime_ns if path.is_file() else 0 for path in paths}


@pytest.fixture
def refused(monkeypatch, capsys) -> Callable[..., str]:
    """Return a function that runs a command which must fail, and returns its line of error.

    It must leave the working directory as it is.
    """

    def run(module: ModuleType, *typed: object) -> str:
        before = contents()
        monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, typed)])
        with pytest.raises(SystemExit) as stopped:
            cli.run(module.command)
        assert stopped.value.code == 2 and contents() == before
        text = capsys.readouterr().err
        assert text.startswith("error: ") and text.count("\n") == 1
        return text

    return run


@pytest.fixture
def single_thread() -> Iterator[None]:
    """Run torch on one thread, since many threads would only wait for each other here."""
    with one_thread(torch.device("cpu")):
        yield


@pytest.fixture
def constants(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that changes constants of an algorithm for a test."""

    def change(algorithm: str, **values: object) -> None:
        for name, value in values.items():
            monkeypatch.setattr(OPTIONS[algorithm], name, value)

    return change


@pytest.fixture
def make_agent(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Agent]:
    """Return a factory of small agents whose policies and values depend on the trade-off."""

    def make(
        observation_size: int = 3,
        action_size: int = 2,
        num_objectives: int = 2,
        scale: float = 0.3,
        **network: object,
    ) -> Agent:
        monkeypatch.setattr(NetworkConfig, "scale", scale)
        layers = {"hidden": (8,), "features": 4, "actor": (6, 5), "critic": (7,)}
        changes = {"network": NetworkConfig.model_validate({**layers, **network})}
        config = load_config(task_values("hopper", "cpu")).model_copy(update=changes)
        generator = torch.Generator().manual_seed(0)
        objectives = tuple(map(str, range(num_objectives)))
        sizes = {"observation_size": observation_size, "action_size": action_size}
        return Agent(config, Task(objectives=objectives, **sizes), generator)

    return make


@pytest.fixture
def make_rollout(generator: torch.Generator) -> Callable[..., Rollout]:
    """Return a factory of random rollouts in which some steps terminate and some truncate."""

    def noise(*shape: int) -> torch.Tensor:
        return torch.randn(12, 3, 4, *shape, generator=generator)  # (T, K, G, ...)

    def make(num_objectives: int = 2) -> Rollout:
        fate = torch.rand(12, 3, 4, generator=generator)
        return Rollout(
            observation=noise(3),
            action=noise(2),
            log_prob=noise(),
            reward=noise(num_objectives),
            terminated=fate < 0.15,
            truncated=fate > 0.85,
            final_observation=noise(3),
        )

    return make


@pytest.fixture(scope="session")
def make_policy() -> Callable[..., Policy]:
    """Return a factory of untrained policies whose actions depend on the trade-off."""

    def make(name: str = "hopper", **changes: dict) -> Policy:
        config = load_config(merged(task_values(name, "cpu"), changes))
        env = envs.make(name, 1, "cpu")
        generator = torch.Generator().manual_seed(0)
        agent = Agent(config, env, generator)
        torch.nn.init.normal_(agent.actor.weight, std=0.2, generator=generator)
        return Policy(agent, config, env.objectives)

    return make


@pytest.fixture
def crowd() -> None:
    """Register the tasks of `crowd` for a test."""
    envs.register("crowd", Crowd)
    envs.register("bowling", Bowling)


@pytest.fixture(scope="session")
def make_front() -> Callable[[tuple[str, ...]], Front]:
    """Return a factory of fronts: corners, an even trade-off, and one that the even dominates."""

    def make(objectives: tuple[str, ...]) -> Front:
        m = len(objectives)
        rest = [0.4 / (m - 1)] * (m - 1)
        tradeoffs = np.vstack([np.eye(m), np.full((1, m), 1 / m), [[0.6, *rest]]])
        returns = 100.0 * tradeoffs + 10
        returns[m:] = [[60.0] * m, [40.0] * m]
        lengths, falls = np.full(m + 2, 200), np.zeros(m + 2)
        return Front(objectives, tradeoffs, returns, lengths, np.zeros(m), falls)

    return make


@pytest.fixture
def opengl() -> None:
    """Choose an OpenGL backend; skip the test if there is none."""
    try:
        choose_opengl()
    except MorlaxError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def make_run(make_front, make_policy) -> Callable[..., Path]:
    """Return a factory of run folders with untrained policies and a front.

    `env` is the task that the files name instead, as an attacker's would: its code does not run.
    """

    def make(folder: Path, task: str, *checkpoints: str, env: str = "") -> Path:
        policy = make_policy(task, network={"actor": [8]}, task={"episode_length": 200})
        object.__setattr__(policy.config, "env", env or task)
        (folder / "checkpoints").mkdir(parents=True)
        for name in checkpoints:
            save(policy, folder / "checkpoints" / f"{name}.pt")
        mark = fingerprint(policy.agent.state_dict())
        make_front(policy.objectives)._replace(fingerprint=mark).save(folder / "front.npz")
        return folder

    return make
