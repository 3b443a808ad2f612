"""A compiled MuJoCo model as MJCF and assets that older versions of MuJoCo load too."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import mujoco
import numpy as np

from ...envs import Environment, MorlaxError
from ...envs.worlds.options import TaskOptions

# Arrays of mjModel that the physics depends on, and the names that their versions share.
PHYSICAL = re.compile(
    r"(body|jnt|dof|geom|site|actuator|eq|tendon|pair|wrap|sensor|qpos)_?\w*"
    r"(?<!_user)(?<!user)(?<!aabb)(?<!rgba)"
)
# MuJoCo 4.0 writes this attribute also where it says nothing; 3.14 then refuses the file.
INPUT_OF_PLAIN_ACTUATORS = re.compile(r"(<general\b[^>]*?) input=\"[^\"]*\"")


class WebModel(NamedTuple):
    """A model as text, for any version of MuJoCo."""

    xml: str
    assets: dict[str, bytes]  # by the names that `xml` has
    fields: dict[str, list[float]]  # exact numbers of mjModel, which `xml` has rounded
    options: dict[str, Any]  # of mjOption


def compiled(task: type[Environment], options: TaskOptions) -> tuple[mujoco.MjModel, WebModel]:
    """Compile a task's model, in any way that MuJoCo offers, and describe it."""
    with _watching() as made:
        model = task.compile_model(options)
    name = f"{task.__name__} cannot run in a browser"
    if not made:
        raise MorlaxError(
            f"{name}: its load_model() must compile the model with MjModel.from_xml_path, "
            "MjModel.from_xml_string or MjSpec.compile."
        )
    spec = next((spec for compiled, spec in made if compiled is model), made[-1][1])
    try:
        return model, _described(model, spec)
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise MorlaxError(f"{name}: {reason}.") from None


def _described(model: mujoco.MjModel, spec: mujoco.MjSpec) -> WebModel:
    """Describe `model`, which `spec` was compiled to; ValueError or OSError: it cannot be."""
    assets = dict(_flattened(spec))
    spec.compiler.meshdir = spec.compiler.texturedir = ""
    spec.assets = assets
    spec.compile()  # only a compiled spec can be written
    xml = INPUT_OF_PLAIN_ACTUATORS.sub(r"\1", spec.to_xml())
    again = mujoco.MjModel.from_xml_string(xml, assets)
    fields = {}
    for name in dir(model):
        values = getattr(model, name, None)
        if not isinstance(values, np.ndarray):
            continue
        copied = getattr(again, name)
        if values.shape != copied.shape:
            raise ValueError(f"its {name} has another size after it was saved as XML")
        if PHYSICAL.fullmatch(name) and values.dtype.kind == "f" and values.size:
            fields[name] = values.ravel().tolist()
    options = {k: getattr(model.opt, k) for k in dir(model.opt) if not k.startswith("_")}
    arrays = {k: x.tolist() for k, x in options.items() if isinstance(x, np.ndarray)}
    numbers = {k: x for k, x in options.items() if isinstance(x, (int, float))}
    return WebModel(xml, assets, fields, arrays | numbers)


@contextmanager
def _watching() -> Iterator[list[tuple[mujoco.MjModel, mujoco.MjSpec]]]:
    """Note every model that is compiled in the block, with a copy of its spec."""
    made: list[tuple[mujoco.MjModel, mujoco.MjSpec]] = []

    def noting(owner: type, name: str, spec_of: Callable[..., mujoco.MjSpec]) -> Any:
        compile_ = getattr(owner, name)

        def substitute(source: Any, *assets: Any, **named: Any) -> mujoco.MjModel:
            model = compile_(source, *assets, **named)
            made.append((model, spec_of(source, **({"assets": assets[0]} if assets else named))))
            return model

        return patch.object(owner, name, substitute)

    with (
        noting(mujoco.MjSpec, "compile", mujoco.MjSpec.copy),
        noting(mujoco.MjModel, "from_xml_path", mujoco.MjSpec.from_file),
        noting(mujoco.MjModel, "from_xml_string", mujoco.MjSpec.from_string),
    ):
        yield made


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
