"""The files of configs: read, merged with a task's tuned values, and written."""

import math
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, Field

from .. import envs
from ..envs.errors import MorlaxError, line, validated
from ..envs.naming import is_file
from ..host.files import AnyPath, read, write_file
from ..host.torchrun import PROCESSES

RECORD = """\
# A record: the checkpoints hold the config that counts. Only --resume reads this file, for the
# limits, evaluation, device and backend. --env FILE.py:CLASS names a task that has moved.
"""


def task_values(env: str, device_type: str, algorithm: str = "morlax") -> dict[str, Any]:
    """Return the tuned values of a task for "cuda" or "cpu".

    They come from configs/<env>.yaml, for "mjlab:TASK" configs/mjlab/TASK.yaml, else from that of
    the simulator, such as configs/mjlab.yaml, and for all other tasks from configs/default.yaml. A
    file may change the values of another one, its `base`. An algorithm other than MORLAX changes
    what configs/algorithms/<algorithm>.yaml says, for the task itself in the section `tasks`. Of a
    file's section `gpus`, the changes for at most as many GPUs as `torchrun` has started processes
    apply.
    """
    task = envs.get(env)
    names = [getattr(task, "simulator", "default"), "default"]
    if not is_file(env):
        name = env.replace(":", "/")  # of mjlab, a twin with fewer observations has no own values
        names = [name, name.removesuffix("-No-State-Estimation"), *names]
    values = next(filter(None, (_packaged(name, device_type) for name in names)))
    if not task.shows_endings:
        values = merged(values, {"ppo": {"truncation": "mask"}})
    changes = _packaged(f"algorithms/{algorithm}", device_type, env)
    return {**merged(values, changes), "env": env, "algorithm": algorithm}


@cache
def required_values(algorithm: str) -> dict[str, Any]:
    """Return the values that an algorithm cannot do without: `required` in its packaged file."""
    return _read_packaged(f"algorithms/{algorithm}").get("required", {})


def _read_packaged(name: str) -> dict[str, Any]:
    file = resources.files("morlax_torch.configs") / f"{name}.yaml"
    return _over_base(yaml.safe_load(file.read_text())) if file.is_file() else {}


def _over_base(values: dict[str, Any]) -> dict[str, Any]:
    """Merge a file's values over those of its `base`, the name of a packaged file."""
    base = values.pop("base", None)
    if base is None:
        return values
    if not (below := _read_packaged(base)):
        raise MorlaxError(f"there is no configs/{base}.yaml, the base of a config: name another.")
    return merged(below, values)


def _packaged(name: str, device_type: str, env: str = "") -> dict[str, Any]:
    """Return a packaged file's values for a task: its section `cpu` overrides its `tasks`."""
    values = _read_packaged(name)
    required, of_task = values.pop("required", {}), values.pop("tasks", {}).get(env, {})
    return merged(_fitted(merged(values, of_task), device_type), required)


def file_values(
    path: Path,
    device_type: str,
    env: str | None = None,
    algorithm: str | None = None,
    all_gpus: bool = False,
) -> dict[str, Any]:
    """Return the values of a YAML file for "cuda" or "cpu" over those of its task and algorithm.

    `env` and `algorithm` are those of the command line; another task may use the file's values.
    `all_gpus` applies the whole section `gpus`, to check it.
    """
    values = _fitted(_over_base(read_yaml(path)), device_type, all_gpus)
    if algorithm is not None and values.setdefault("algorithm", algorithm) != algorithm:
        raise MorlaxError(
            f"{path} is for algorithm {values['algorithm']!r}, but --algorithm says {algorithm!r}."
        )
    if env is not None:
        values["env"] = env
    if not isinstance(values.get("env"), str):
        return values
    return over_task_values(values["env"], values, device_type)


def over_task_values(env: str, changes: dict[str, Any], device_type: str) -> dict[str, Any]:
    """Return a task's tuned values with changes, without a focus that weighs other objectives."""
    values, task = task_values(env, device_type, algorithm_of(changes)), changes.get("task")
    if isinstance(task, dict) and "objectives" in task:
        values = merged(values, {"sampling": {"focus": None}})
    return merged(values, changes)


def algorithm_of(values: dict[str, Any]) -> str:
    return str(values.get("algorithm", "morlax"))


def read_yaml(path: AnyPath, what: str = "config", such_as: str = "env: ant") -> dict[str, Any]:
    """Read a YAML file of keys and values; errors name its kind, and a line `such_as` it has."""
    try:
        values = yaml.load(read(path, what), _UniqueKeys)
    except (yaml.YAMLError, ValueError) as error:
        raise MorlaxError(f"the {what} {path} is not valid YAML: {line(error)}") from None
    except RecursionError:
        raise MorlaxError(f"the {what} {path} is nested too deeply.") from None
    if not isinstance(values, dict):
        raise MorlaxError(f"the {what} {path} must hold keys and values, such as {such_as}.")
    return values


class _UniqueKeys(yaml.SafeLoader):
    """Refuses a key that appears twice, of which YAML would silently take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        keys = [key.value for key, _ in node.value]
        for key in (key for index, key in enumerate(keys) if key in keys[:index]):
            raise yaml.MarkedYAMLError(f"the key {key} appears twice", node.start_mark)
        return super().construct_mapping(node, deep)


def write_yaml(config: BaseModel) -> str:
    """Return a config as YAML, which `read_yaml` reads, a line for each value."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, width=math.inf)


def write_record(config: BaseModel, folder: Path) -> None:
    """Write the config.yaml of a run's folder, with what an edit of it can change."""
    write_file(folder / "config.yaml", RECORD + write_yaml(config))


class _Devices(BaseModel):
    """Changes for some devices that a config's file may hold."""

    cpu: dict[str, Any] | None = None
    gpus: dict[Annotated[int, Field(ge=2)], dict[str, Any]] | None = None


def _fitted(values: dict[str, Any], device_type: str, all_gpus: bool = False) -> dict[str, Any]:
    """Apply the section `cpu` without a GPU, and the changes in `gpus` for this number of GPUs."""
    devices = validated(_Devices, values)
    values = {name: value for name, value in values.items() if name not in _Devices.model_fields}
    if device_type == "cpu":
        return merged(values, devices.cpu or {})
    for number, changes in sorted((devices.gpus or {}).items()):
        if all_gpus or number <= PROCESSES:
            values = merged(values, changes)
    return values


def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Merge `above` over `below`, section by section; groups of reward terms are replaced whole."""
    result = dict(below)
    for key, value in above.items():
        sections = isinstance(value, dict) and isinstance(below.get(key), dict)
        sections = sections and key not in ("objectives", "shared", "guide")
        result[key] = merged(below[key], value) if sections else value
    return result


def nested(name: str, value: Any) -> dict[str, Any]:
    """Return the value of a dotted name as sections, as `merged` takes them."""
    for part in reversed(name.split(".")):
        value = {part: value}
    return value
