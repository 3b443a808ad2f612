"""The private names of other libraries that the package uses, and what tests each of them.

A new minor version may change them, so pyproject.toml bounds most of these libraries. PyTorch and
Stable-Baselines3 have no bound: users choose their versions.
"""

import ast
import re
import tomllib
from collections.abc import Iterator
from inspect import signature
from pathlib import Path

import torch
import warp as wp

from morlax_torch import __file__ as package

ROOT = Path(__file__).parents[2]
FOLDERS = (Path(package).parent, ROOT / "envs")
# os._exit and the methods of named tuples are documented
PUBLIC = {"_exit", "_asdict", "_replace", "_fields", "_field_defaults"}

TESTED = {  # names, by the file whose tests use them
    "adapters/test_pareto_ppo.py": ("_reward_termination",),
    "adapters/test_sb3.py": ("_get_indices", "_reset_seeds"),
    "algorithms/test_hyper_sac.py": ("_foreach_lerp_",),
    "commands/test_startup.py": ("_initializing",),
    "envs/test_mjlab.py": (  # which compares the step that uses these names with mjlab's
        *("_reset_mask", "_reset_mask_wp", "_wrapped_cache", "_torch_stream", "_setup_stream"),
        *("_mode_term_cfgs", "_interval_term_time_left", "_group_obs_class_term_cfgs"),
        *("_class_term_cfgs", "_term_cfgs", "_step_reward", "_clip", "_local_offsets"),
        *("_eigh_3x3_jacobi", "_extract_yaw_rotation", "_group_obs_class_instances"),
    ),
    "envs/test_tracking.py": (  # likewise
        *("_adaptive_sampling", "_uniform_sampling", "_resample_command"),
        *("_current_bin_failed", "_pending_forward"),
    ),
    "envs/test_physics.py": ("_src",),
    "evaluation/test_designs.py": ("_buffers",),
    "networks/test_tradeoffs.py": ("_standard_gamma",),
    "packaging/test_private_names.py": (
        *("_C", "_are_functorch_transforms_active", "_base", "_cdata", "_version"),
        *("_compile", "_get_compile_output_name"),
    ),
    "viewers/test_web.py": ("_python_dispatch", "_pytree", "_schema", "_local_scalar_dense"),
}


def test_torch_tells_whether_a_transform_is_active():
    def active(x: torch.Tensor) -> torch.Tensor:
        return x + torch._C._are_functorch_transforms_active()

    assert active(torch.zeros(2)).tolist() == [0, 0]
    assert torch.vmap(active)(torch.zeros(2)).tolist() == [1, 1]


def test_torch_tells_what_a_tensor_shares_and_whether_it_has_changed():
    whole = torch.zeros(2, 6)
    part = whole[:, :3]
    assert part._base is whole and whole._base is None
    assert part.untyped_storage()._cdata == whole.untyped_storage()._cdata
    before = whole._version
    part.add_(1)
    assert whole._version > before


def test_warp_compiles_a_module_with_these_arguments():
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


def test_simulators_are_bounded():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *extras["mjlab"]]
    bounded = {line.split(">")[0] for line in lines if ",<" in line}
    assert bounded == {"warp-lang", "mujoco-warp", "mujoco", "mjlab"}


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
    used = {name for node in nodes for name in read(node) if re.match("_[^_]", name)} - PUBLIC
    listed = {name for names in TESTED.values() for name in names}
    assert all((ROOT / "tests" / file).is_file() for file in TESTED)
    assert used - own <= listed, "list it above, with what tests it"
    assert listed <= used, "no longer used"
