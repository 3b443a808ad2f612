"""Write runs as a page: a folder for any static web server."""

import gzip
import json
import os
from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from ...envs import Environment, MorlaxError
from ...envs.naming import title
from ...envs.registry import get
from ...exports.exporting import export
from ...exports.formats import onnxruntime
from ...host.files import making
from ...host.phases import phase, within
from ...networks.policy import Policy
from ...runs.evaluating import front_of
from ...runs.loading import bookmarks, load
from .. import libraries
from ..describing import array_bytes, described_task, drawn_arrays, front_map
from ..player import PUSH
from .model import WebModel, compiled
from .recording import storage
from .tracing import ARRAYS, OnnxGraph, PagePhysics, Traced, check, trace

TITLE = "TITLE"  # in index.html
START = "start.bin"  # a recording, which the page shows until it has loaded the robot itself
SECONDS = 5.0  # of the recording; an episode that ends earlier is recorded to its end
FRAME = 0.02  # s between its frames, or a control step if that is longer
STARTS = 16  # initial states on the page, where a task draws them at random
NOMINAL = {"friction": None, "mass": None, "strength": None, "fields": {}}


def write_page(runs: Sequence[str], folder: Path, device: str | None = None) -> int:
    """Write a page on which policies act in a browser; return its size in bytes.

    The folder must be new or empty, and is complete or not there at all. `device` evaluates the
    front of a run that has none.
    """
    folder = Path(os.path.abspath(folder))
    with making(folder) as draft:
        _write(runs, draft, device)
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _write(runs: Sequence[str], folder: Path, device: str | None) -> None:
    onnxruntime()  # fails at once without the extra
    (folder / "libraries").mkdir()
    for name, data in libraries.files().items():
        (folder / "libraries" / name).write_bytes(data)
    shared = sum(_compress(file) for file in (folder / "libraries").glob("*.wasm"))
    listed: list[dict[str, Any]] = []
    titles = Counter[str]()
    for index, run in enumerate(runs):
        part = folder / f"runs/{index}"
        with within(Path(run).name):
            robot = write_robot(run, part, device)
        # the page counts from when it shows the recording
        size = sum(_compress(file) for file in list(part.iterdir()) if file.name != START)
        _compress(part / START)
        titles[robot["title"]] += 1
        if (number := titles[robot["title"]]) > 1:  # tell runs of one task apart
            robot["title"] += f" {number}"
        listed.append({"folder": f"runs/{index}", **robot, "bytes": size, "shared": shared})
    (folder / "runs.json").write_text(json.dumps(listed))
    heading = ", ".join(robot["title"] for robot in listed)
    for path, data in libraries.page_files().items():
        if path == "index.html":
            data = data.replace(TITLE.encode(), escape(heading).encode())
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)


def _compress(file: Path) -> int:
    """Compress a file in place; return its new size."""
    # for the page to decompress, since many web servers send files as they are; those that know
    # the usual endings of compressed files would decompress them a second time
    packed = file.with_name(f"{file.name}.packed")
    packed.write_bytes(gzip.compress(file.read_bytes()))
    file.unlink()
    return packed.stat().st_size


def write_robot(run: str, folder: Path, device: str | None = None) -> dict[str, Any]:
    """Write the page's files of one run into a new folder; return its title and objectives."""
    policy = load(run)
    env, model = build(policy)
    phase("tracing the task")
    traced = trace(env)
    check(env, traced, torch.Generator().manual_seed(0))
    folder.mkdir(parents=True)
    (folder / START).write_bytes(start(policy, env))
    export(policy, folder / "policy.onnx")
    for name, graph in (("before", traced.before), ("after", traced.after)):
        (folder / f"{name}.onnx").write_bytes(graph.onnx)
    (folder / "model.xml").write_text(model.xml)
    for name, data in model.assets.items():
        (folder / name).write_bytes(data)
    front = front_of(run, policy, device)
    policy.cpu()
    heading = {"title": title(policy.config.env), "objectives": list(policy.objectives)}
    drawn = {"front": front_map(front, env.dt, env.lower_is_better), "bookmarks": bookmarks(run)}
    everything = {**heading, **described(env, traced, model), **drawn}
    (folder / "run.json").write_text(json.dumps(everything, separators=(",", ":")))
    return heading


def build(policy: Policy) -> tuple[Environment, WebModel]:
    """Build the policy's task in float32, without domain randomization of the model."""
    name, options = policy.config.env, policy.config.task.for_evaluation()
    task = get(name)
    if not issubclass(task, Environment):
        raise MorlaxError(
            f"{name} cannot run in a browser: only MuJoCo robots that are subclasses of "
            "envs.Environment can."
        )
    options = task.Options.model_validate(options.model_dump())
    nominal = options.randomization.model_copy(update=NOMINAL)
    options = options.model_copy(update={"randomization": nominal})
    model, text = compiled(task, options)
    env = task(PagePhysics(model, task.substeps), options, 0, auto_reset=False)
    policy.agent.check_sizes(env)
    return env, text


def start(policy: Policy, env: Environment) -> bytes:
    """Record the robot with even weights, from the task's first state."""
    model = env.physics.model
    data = mujoco.MjData(model)
    act = policy.specialize([1 / len(policy.objectives)] * len(policy.objectives))
    stride = max(round(FRAME / env.dt), 1)
    observation, over = env.reset(), False
    places, turns = [], []
    for step in range(round(SECONDS / env.dt) + 1):
        data.qpos[:] = env.physics.qpos[0].numpy()
        mujoco.mj_kinematics(model, data)
        if over or not np.isfinite(data.xpos).all():
            break
        if step % stride == 0:
            places.append(data.xpos.copy())
            turns.append(data.xquat.copy())
        observation, _, terminated, truncated, *_ = env.step(act(observation))
        over = bool(terminated | truncated)
    poses = {"places": np.array(places), "turns": np.array(turns)}  # (T, nbody, 3 or 4)
    sizes = {"nbody": model.nbody, "ngeom": model.ngeom, "followed": env.base}
    return array_bytes({**drawn_arrays(model), **poses}, **sizes, dt=stride * env.dt)


def described(env: Environment, traced: Traced, model: WebModel) -> dict[str, Any]:
    """Describe a task and its graphs for the page."""
    many = STARTS if len(env.starts.states[0]) > 1 else 1
    command = None
    if env.command_limits:
        assert storage(env.command) == storage(env.command[0])
        command = {
            "offset": env.command.storage_offset(),  # where the state named "command" has it
            "limits": {name: list(limits) for name, limits in env.command_limits.items()},
            "initial": _numbers(env.command[0]),
        }
    return {
        **described_task(env),
        "substeps": env.substeps,
        "observation_size": env.observation_size,
        "action_size": env.action_size,
        "terms": list(traced.terms),
        "physics": ARRAYS,
        "fields": model.fields,
        "options": {**model.options, "disableflags": int(env.physics.model.opt.disableflags)},
        "assets": list(model.assets),
        "state": {name: str(values.dtype)[6:] for name, values in traced.state.items()},
        "before": _graph(traced.before),
        "after": _graph(traced.after),
        # observation and state after resets
        "starts": [
            {"observation": _numbers(env.reset())}
            | {name: _numbers(values) for name, values in traced.state.items()}
            for _ in range(many)
        ],
        "command": command,
        "push": PUSH,
    }


def _graph(graph: OnnxGraph) -> dict[str, Any]:
    return {
        "inputs": {
            name: {"shape": list(values.shape), "type": str(values.dtype)[6:]}
            for name, values in graph.inputs.items()
        },
        "outputs": list(graph.outputs),
        "draws": {name: draw._asdict() for name, draw in graph.draws.items()},
    }


def _numbers(values: Tensor) -> list[float]:
    return np.round(values.flatten().double().numpy(), 9).tolist()
