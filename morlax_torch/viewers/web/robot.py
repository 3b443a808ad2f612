"""One run as files for the page: model, graphs, policy, initial states and front."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...envs import Environment, MorlaxError
from ...envs.naming import title
from ...envs.registry import get
from ...envs.worlds.trees import horizontal
from ...exports.exporting import export
from ...host.phases import phase
from ...networks.policy import Policy
from ...runs.evaluating import front_of
from ...runs.loading import bookmarks, load
from ..explaining import explain, is_told_velocity
from ..front_map import front_map
from .checking import check
from .model import WebModel, compiled
from .recording import storage
from .start import start
from .tracing import ARRAYS, OnnxGraph, PagePhysics, Traced, trace

START = "start.bin"  # what the page shows first
STARTS = 16  # initial states on the page, where a task draws them at random
NOMINAL = {"friction": None, "mass": None, "strength": None, "fields": {}}
PUSH = 1.5  # m/s added to the robot's velocity by a push


def write_robot(run: str, folder: Path, device: str | None = None) -> dict[str, Any]:
    """Write the files that the page needs of one run into a new folder, see `write_page`.

    Returns the run's title and objectives, for a list of runs.

    Raises:
        MorlaxError: there is no such run, or its task cannot run in a browser.
    """
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
    about = {"title": title(policy.config.env), "objectives": list(policy.objectives)}
    drawn = {"front": front_map(front, env.dt, env.lower_is_better), "bookmarks": bookmarks(run)}
    everything = {**about, **described(env, traced, model), **drawn}
    (folder / "run.json").write_text(json.dumps(everything, separators=(",", ":")))
    return about


def build(policy: Policy) -> tuple[Environment, WebModel]:
    """Build the policy's task in float32, without domain randomization of the model.

    Raises:
        MorlaxError: the task is no MuJoCo robot of this package's kind, or its model cannot be
            written as MJCF.
    """
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
    model, described = compiled(lambda: task.compile_model(options), task.__name__)
    physics = PagePhysics(model, task.substeps)
    env = task(physics, options, 0, auto_reset=False)
    policy.agent.check_sizes(env)
    return env, described


def described(env: Environment, traced: Traced, model: WebModel) -> dict[str, Any]:
    """Describe a task and its graphs for the page."""
    return {
        "dt": env.dt,
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
        "starts": _starts(env, traced),
        "command": _command(env),
        "velocities": is_told_velocity(env),
        "notes": [explain(env, name) for name in env.objectives],
        "followed": env.base,
        "pushed": horizontal(env.physics.model, env.base),
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


def _starts(env: Environment, traced: Traced) -> list[dict[str, list[float]]]:
    """Return the whole state after some resets, with the first observation of each."""
    many = STARTS if len(env.starts.states[0]) > 1 else 1
    found = []
    for _ in range(many):
        observation = env.reset()
        found.append({"observation": _numbers(observation)})
        found[-1] |= {name: _numbers(values) for name, values in traced.state.items()}
    return found


def _command(env: Environment) -> dict[str, Any] | None:
    """Return the limits and initial values of the command, and where its storage has it."""
    if not env.command_limits:
        return None
    assert storage(env.command) == storage(env.command[0])
    return {
        "offset": env.command.storage_offset(),
        "limits": {name: list(limits) for name, limits in env.command_limits.items()},
        "initial": _numbers(env.command[0]),
    }


def _numbers(values: Tensor) -> list[float]:
    return np.round(values.flatten().double().numpy(), 9).tolist()
