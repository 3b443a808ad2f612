"""The private names of other libraries that the package uses, each with a test of its use.

A new minor version may change them, so pyproject.toml bounds most of these libraries. PyTorch and
Stable-Baselines3 have no bound: users choose their versions.
"""

import ast
import importlib.util
import tomllib
from collections.abc import Callable, Iterator
from inspect import signature
from pathlib import Path
from typing import Any

import pytest
import torch
import warp as wp

from morlax_torch import __file__ as package

ROOT = Path(__file__).parents[2]
FOLDERS = (Path(package).parent, ROOT / "envs")
# os._exit and the methods of named tuples are documented
PUBLIC = {"_exit", "_asdict", "_replace", "_fields", "_field_defaults"}

USES: dict[str, tuple[str, Callable[[], None]]] = {}  # name: library and test
# test_mjlab.py compares the step that uses these names with mjlab's
OF_MJLAB = {
    *("_reset_mask", "_reset_mask_wp", "_wrapped_cache", "_torch_stream", "_setup_stream"),
    *("_mode_term_cfgs", "_interval_term_time_left", "_group_obs_class_term_cfgs"),
    *("_class_term_cfgs", "_term_cfgs", "_step_reward", "_clip", "_local_offsets"),
    *("_eigh_3x3_jacobi", "_uniform_sampling"),
}


def private(library: str, *names: str) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """Register a test of names of a library."""

    def register(test: Callable[[], None]) -> Callable[[], None]:
        USES.update(dict.fromkeys(names, (library, test)))
        return test

    return register


@private("torch", "_standard_gamma")
def gamma() -> None:
    generator = torch.Generator().manual_seed(0)
    drawn = torch._standard_gamma(torch.full((10_000,), 3.0), generator=generator)
    assert drawn.mean().item() == pytest.approx(3.0, abs=0.1)
    again = torch._standard_gamma(torch.full((10_000,), 3.0), generator=generator.manual_seed(0))
    assert torch.equal(drawn, again)


@private("torch", "_foreach_lerp_")
def lerp() -> None:
    tensors = [torch.zeros(2), torch.zeros(3)]
    torch._foreach_lerp_(tensors, [torch.ones(2), torch.ones(3)], 0.25)
    assert torch.cat(tensors).tolist() == [0.25] * 5


@private("torch", "_C", "_are_functorch_transforms_active")
def transforms() -> None:
    def active(x: torch.Tensor) -> torch.Tensor:
        return x + torch._C._are_functorch_transforms_active()

    assert active(torch.zeros(2)).tolist() == [0, 0]
    assert torch.vmap(active)(torch.zeros(2)).tolist() == [1, 1]


@private("torch", "_base", "_cdata", "_version")
def memory() -> None:
    whole = torch.zeros(2, 6)
    part = whole[:, :3]
    assert part._base is whole and whole._base is None
    assert part.untyped_storage()._cdata == whole.untyped_storage()._cdata
    before = whole._version
    part.add_(1)
    assert whole._version > before


@private("torch", "_buffers")
def buffers() -> None:
    module = torch.nn.BatchNorm1d(2)
    assert module._buffers["running_mean"] is module.running_mean


@private("torch", "_python_dispatch", "_pytree", "_schema", "_local_scalar_dense")
def dispatch() -> None:
    from torch.utils._python_dispatch import TorchDispatchMode
    from torch.utils._pytree import tree_leaves, tree_map

    calls = []

    class Calls(TorchDispatchMode):
        def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None):
            calls.append(func)
            return func(*args, **(kwargs or {}))

    with Calls():
        torch.zeros(1).uniform_().item()
    drawing, reading = calls[-2:]
    assert drawing._schema.name == "aten::uniform_" and drawing._schema.is_mutable
    assert [argument.name for argument in drawing._schema.arguments][:2] == ["self", "from"]
    assert drawing._schema.arguments[0].alias_info.is_write
    assert reading is torch.ops.aten._local_scalar_dense.default
    assert tree_leaves(tree_map(abs, {"a": [-1, (-2,)]})) == [1, 2]


@private("warp", "_compile", "_get_compile_output_name")
def compiling() -> None:
    module = wp.Module("private_names")
    # public, but replaced or called by envs/physics/compiling.py, which needs these arguments
    assert {"device", "block_dim"} <= set(signature(wp.Module.load).parameters)
    assert list(signature(wp.capture_while).parameters)[:2] == ["condition", "while_body"]
    branches = ["condition", "on_true", "on_false"]
    assert list(signature(wp.capture_if).parameters)[:3] == branches
    assert list(signature(wp.get_suggested_block_size).parameters) == ["kernel", "device"]
    for name in ("array_scan", "radix_sort_pairs", "segmented_sort_pairs"):
        assert callable(getattr(wp.utils, name))
    options = module.resolve_options(wp.config, 1)
    signature(module._compile).bind(wp.get_device("cpu"), options=options)
    file = module._get_compile_output_name(wp.get_device("cpu"), block_dim=1)
    assert Path(file).suffix == ".o" and module.get_module_identifier(1)


@private("mujoco_warp", "_src")
def overflow() -> None:
    from mujoco_warp._src.types import OverflowType

    assert OverflowType.NEFC | OverflowType.NJMAX_NNZ == 3


@private("stable_baselines3", "_get_indices", "_reset_options", "_reset_seeds")
def vectors() -> None:
    from stable_baselines3.common.vec_env import VecEnv

    class Empty(VecEnv):
        num_envs = 3

    Empty.__abstractmethods__ = frozenset()
    env = Empty.__new__(Empty)
    env._reset_seeds(), env._reset_options()
    assert (env._seeds, env._options) == ([None] * 3, [{}] * 3)
    assert (list(env._get_indices(None)), list(env._get_indices(1))) == ([0, 1, 2], [1])


@private("mjlab", "_extract_yaw_rotation")
def yaw() -> None:
    from mjlab.sensor import RayCastSensor

    sensor = RayCastSensor.__new__(RayCastSensor)
    turned = torch.tensor([[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]])
    torch.testing.assert_close(sensor._extract_yaw_rotation(turned), turned)


INSTALLED = [name for name, (library, _) in USES.items() if importlib.util.find_spec(library)]


@pytest.mark.parametrize("name", INSTALLED)
def test_a_private_name_works_as_the_package_uses_it(name):
    _, test = USES[name]
    test()


def test_simulators_are_bounded():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *extras["mjlab"]]
    bounded = {line.split(">")[0] for line in lines if ",<" in line}
    assert bounded == {"warp-lang", "mujoco-warp", "mujoco", "mjlab"}


def is_private(name: str) -> bool:
    return len(name) > 1 and name.startswith("_") and not name.startswith("__")


def defined(node: ast.AST) -> Iterator[str]:
    """Yield the names that a node of Python's syntax tree defines."""
    match node:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
            yield name
        case ast.Attribute(attr=name, value=ast.Name("self" | "cls"), ctx=ast.Store()):
            yield name
        case ast.Name(id=name, ctx=ast.Store()):
            yield name


def read(node: ast.AST) -> Iterator[str]:
    """Yield the attributes and imported modules that a node names."""
    match node:
        case ast.Attribute(attr=name):
            yield name
        case ast.Call(ast.Name("getattr" | "hasattr"), [_, ast.Constant(str(name)), *_]):
            yield name
        case ast.ImportFrom(module=str(module), names=aliases, level=0):
            yield from (*module.split("."), *(alias.name for alias in aliases))
        case ast.Import(names=aliases):
            yield from (part for alias in aliases for part in alias.name.split("."))


def test_every_private_name_of_another_library_is_listed():
    files = [file for folder in FOLDERS for file in folder.rglob("*.py")]
    nodes = [node for file in files for node in ast.walk(ast.parse(file.read_text()))]
    own = {name for node in nodes for name in defined(node)}
    used = {name for node in nodes for name in read(node) if is_private(name)} - PUBLIC
    listed = OF_MJLAB | set(USES)
    assert used - own <= listed, "list it above, with a test"
    assert listed <= used, "no longer used"
