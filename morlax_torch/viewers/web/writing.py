"""Write runs as a page: a folder for any static web server."""

import gzip
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import mujoco
import numpy as np
from torch import Tensor

from ...envs import Environment, MorlaxError, TaskOptions, get
from ...envs.naming import title
from ...exports.exporting import export, onnxruntime
from ...host.files import making
from ...host.phases import phase, within
from ...networks.policy import Policy
from ...runs.loading import bookmarks, front_of, load
from .. import libraries
from ..describing import described_task, front_map, model_bytes
from ..player import PUSH, Player
from .tracing import ARRAYS, OnnxGraph, PagePhysics, Traced, cannot, trace

# Arrays of mjModel that the physics depends on, and the names that their versions share.
PHYSICAL = re.compile(
    r"(body|jnt|dof|geom|site|actuator|eq|tendon|pair|wrap|sensor|qpos)_?\w*"
    r"(?<!_user)(?<!user)(?<!aabb)(?<!rgba)"
)
# MuJoCo 4.0 writes this attribute also where it says nothing; 3.14 then refuses the file.
INPUT_OF_PLAIN_ACTUATORS = re.compile(r"(<general\b[^>]*?) input=\"[^\"]*\"")
START = "start.bin"  # a recording, which the page shows until it has loaded the robot itself
SECONDS = 5.0  # of the recording; an episode that ends earlier is recorded to its end
FRAME = 0.02  # s between its frames, or a control step if that is longer
STARTS = 16  # initial states on the page, where a task draws them at random
NOMINAL = {"friction": None, "mass": None, "strength": None, "fields": {}}


class WebModel(NamedTuple):
    """A model as text, for any version of MuJoCo."""

    xml: str
    assets: dict[str, bytes]  # by the names that `xml` has
    fields: dict[str, list[float]]  # exact numbers of mjModel, which `xml` has rounded
    options: dict[str, Any]  # of mjOption


def compiled(task: type[Environment], options: TaskOptions) -> tuple[mujoco.MjModel, WebModel]:
    """Compile a task's model, in any way that MuJoCo offers, and describe it."""
    made: list[tuple[mujoco.MjModel, mujoco.MjSpec]] = []
    compile_ = mujoco.MjSpec.compile

    def noting(spec: mujoco.MjSpec) -> mujoco.MjModel:
        made.append((compile_(spec), spec.copy()))
        return made[-1][0]

    def through(read: Callable[..., mujoco.MjSpec]) -> Callable[..., mujoco.MjModel]:
        return lambda source, assets=None: noting(read(source, assets=assets))

    with (
        patch.object(mujoco.MjSpec, "compile", noting),
        patch.object(mujoco.MjModel, "from_xml_path", through(mujoco.MjSpec.from_file)),
        patch.object(mujoco.MjModel, "from_xml_string", through(mujoco.MjSpec.from_string)),
    ):
        model = task.compile_model(options)
    if not made:
        ways = "MjModel.from_xml_path, MjModel.from_xml_string or MjSpec.compile"
        raise cannot(task, f"its load_model() must compile the model with {ways}")
    spec = next((spec for compiled, spec in made if compiled is model), made[-1][1])
    try:
        return model, _portable(model, spec)
    except (ValueError, OSError) as error:
        raise cannot(task, str(error)) from None


def _portable(model: mujoco.MjModel, spec: mujoco.MjSpec) -> WebModel:
    """Describe `model`, which `spec` was compiled to; ValueError or OSError: it cannot be."""
    assets = dict(_flattened(spec))
    spec.compiler.meshdir = spec.compiler.texturedir = ""
    spec.assets = assets
    spec.compile()  # only a compiled spec can be written
    xml = INPUT_OF_PLAIN_ACTUATORS.sub(r"\1", spec.to_xml())
    again, fields = mujoco.MjModel.from_xml_string(xml, assets), {}
    for name, values in _arrays(model).items():
        if values.shape != getattr(again, name).shape:
            raise ValueError(f"its {name} has another size after it was saved as XML")
        if PHYSICAL.fullmatch(name) and values.dtype.kind == "f" and values.size:
            fields[name] = values.ravel().tolist()
    arrays = {name: values.tolist() for name, values in _arrays(model.opt).items()}
    numbers = {k: getattr(model.opt, k) for k in dir(model.opt) if not k.startswith("_")}
    numbers = {k: x for k, x in numbers.items() if isinstance(x, (int, float))}
    return WebModel(xml, assets, fields, arrays | numbers)


def _arrays(struct: Any) -> dict[str, np.ndarray]:
    values = {name: getattr(struct, name, None) for name in dir(struct)}
    return {name: x for name, x in values.items() if isinstance(x, np.ndarray)}


def _flattened(spec: mujoco.MjSpec) -> Iterator[tuple[str, bytes]]:
    """Give every file of the model a name without folders; yields names and contents."""
    names: dict[Path, str] = {}
    stored = {Path(name).name: data for name, data in spec.assets.items()}
    for kind, folder in (("meshes", "meshdir"), ("textures", "texturedir"), ("hfields", "meshdir")):
        for element in getattr(spec, kind):
            if not element.file:
                continue
            file = Path(element.file)
            element.name = element.name or file.stem
            path = Path(spec.modelfiledir or ".") / getattr(spec.compiler, folder) / file
            element.content_type = ""
            if path not in names:
                names[path] = f"asset-{len(names)}{file.suffix.lower()}"
                yield names[path], stored[file.name] if file.name in stored else path.read_bytes()
            element.file = names[path]


def write_page(runs: Sequence[str], folder: Path, device: str | None = None) -> int:
    """Write a page on which policies act in a browser; return its size in bytes.

    The folder must be new or empty, and is complete or not there at all. `device` evaluates the
    front of a run that has none.
    """
    onnxruntime()  # fails at once without the extra
    folder = Path(os.path.abspath(folder))
    with making(folder) as draft:
        contents, listed = libraries.page_files(), list[dict[str, Any]]()
        titles = Counter[str]()
        for index, run in enumerate(runs):
            part = draft / f"runs/{index}"
            with within(Path(run).name):
                robot = write_robot(run, part, device)
            # the page counts from when it shows the recording
            size = sum(_compress(file) for file in list(part.iterdir()) if file.name != START)
            _compress(part / START)
            titles[robot["title"]] += 1
            if (number := titles[robot["title"]]) > 1:  # tell runs of one task apart
                robot["title"] += f" {number}"
            listed.append({"folder": f"runs/{index}", **robot, "bytes": size})
        heading = escape(", ".join(robot["title"] for robot in listed))
        contents["index.html"] = contents["index.html"].replace(b"TITLE", heading.encode())
        for path, data in contents.items():
            (draft / path).parent.mkdir(exist_ok=True)
            (draft / path).write_bytes(data)
        shared = sum(_compress(file) for file in (draft / "libraries").glob("*.wasm"))
        (draft / "runs.json").write_text(json.dumps([{**x, "shared": shared} for x in listed]))
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


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
    folder.mkdir(parents=True)
    (folder / START).write_bytes(start(policy))
    export(policy, folder / "policy.onnx")
    for name, graph in (("before", traced.before), ("after", traced.after)):
        (folder / f"{name}.onnx").write_bytes(graph.onnx)
    (folder / "model.xml").write_text(model.xml)
    for name, data in model.assets.items():
        (folder / name).write_bytes(data)
    front = front_of(run, policy, device)
    policy.cpu()
    heading = {"title": title(policy.config.env), "objectives": list(policy.objectives)}
    drawn = {"front": front_map(front, env), "bookmarks": bookmarks(run)}
    everything = {**heading, **described(env, traced, model), **drawn}
    (folder / "run.json").write_text(json.dumps(everything, separators=(",", ":")))
    return heading


def build(policy: Policy) -> tuple[Environment, WebModel]:
    """Build the policy's task in float32, without domain randomization of the model."""
    name, options = policy.config.env, policy.config.task.for_evaluation()
    task = get(name)
    if not issubclass(task, Environment):
        raise MorlaxError(f"only MuJoCo robots of envs.Environment run in a browser, not {name}.")
    options = task.Options.model_validate(options.model_dump())
    nominal = options.randomization.model_copy(update=NOMINAL)
    options = options.model_copy(update={"randomization": nominal})
    model, text = compiled(task, options)
    env = task(PagePhysics(model, task.substeps), options, 0, auto_reset=False)
    policy.agent.check_sizes(env)
    return env, text


def start(policy: Policy) -> bytes:
    """Record the robot with even weights, from the task's first state."""
    player = Player(policy, [1.0] * len(policy.objectives))
    model, dt = player.model, player.env.dt
    stride = max(round(FRAME / dt), 1)
    places, turns = [], []
    while player.steps <= SECONDS / dt and np.isfinite(player.data.xpos).all() and not player.over:
        if player.steps % stride == 0:
            places.append(player.data.xpos.copy())
            turns.append(player.data.xquat.copy())
        player.step()
    poses = {"places": np.array(places), "turns": np.array(turns)}  # (T, nbody, 3 or 4)
    return model_bytes(model, poses, followed=player.env.base, dt=stride * dt)


def described(env: Environment, traced: Traced, model: WebModel) -> dict[str, Any]:
    """Describe a task and its graphs for the page."""
    drawn = len(env.starts.states[0]) > 1 or type(env).begin is not Environment.begin  # of goals
    many = STARTS if drawn else 1
    task = described_task(env)
    if env.command_limits:
        task["command"] |= {
            "offset": env.command.storage_offset(),  # where the state named "command" has it
            "initial": _numbers(env.command[0]),
        }
    return {
        **task,
        "substeps": env.substeps,
        "observation_size": env.observation_size,
        "terms": list(traced.terms),
        "physics": ARRAYS,
        "fields": model.fields,
        "options": {**model.options, "disableflags": int(env.physics.model.opt.disableflags)},
        "assets": list(model.assets),
        "before": _graph(traced.before),
        "after": _graph(traced.after),
        # observation and state after resets
        "starts": [
            {"observation": _numbers(env.reset())}
            | {name: _numbers(values) for name, values in traced.state.items()}
            for _ in range(many)
        ],
        "push": PUSH,
    }


def _graph(graph: OnnxGraph) -> dict[str, Any]:
    return {"inputs": graph.inputs, "outputs": graph.outputs, "draws": graph.draws}


def _numbers(values: Tensor) -> list[float]:
    return np.round(values.flatten().double().numpy(), 9).tolist()
