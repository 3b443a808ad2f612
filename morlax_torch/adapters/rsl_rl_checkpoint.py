"""Checkpoints of `ParetoPPO`: plain ones of rsl_rl, and runs of morlax."""

import io
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..configuration.config import Config
from ..configuration.tradeoffs import one_tradeoff
from ..envs import MorlaxError
from ..host.files import AnyPath, read, write_file
from ..networks.hypernetwork import HIDDEN
from ..networks.mlp import mlp
from ..runs.checkpoint import FORMAT, RSL_RL, Task
from .rsl_rl_family import FamilyModel, FamilyStorage, plain_state

FAMILY = "family"  # key of the family in a checkpoint
NORMALIZER = "obs_normalizer."  # before names of what is not trained
# what reading a file raises that is damaged, or of another program
DAMAGES = (
    *(pickle.UnpicklingError, EOFError, RuntimeError),
    *(AttributeError, LookupError, TypeError, ValueError),
)


def specialize(checkpoint: AnyPath, tradeoff: Sequence[float], output: AnyPath) -> None:
    """Write the plain rsl_rl checkpoint of one trade-off (m,), which PPO itself loads.

    It needs neither the worlds nor the host. Training can go on from it: its critic's values are
    those of the weighted rewards, and its optimizer starts anew.

    Raises:
        MorlaxError: the file is no checkpoint of `ParetoPPO`, or the trade-off is invalid.
    """
    unknown = MorlaxError(f"{checkpoint} is no checkpoint that ParetoPPO has written.")
    try:
        data = io.BytesIO(read(Path(checkpoint), "checkpoint"))
        loaded = torch.load(data, map_location="cpu", weights_only=True)
        objectives = loaded[FAMILY]["objectives"]
    except DAMAGES:
        raise unknown from None
    weights = one_tradeoff(tradeoff, objectives, torch.device("cpu"))
    try:
        plain = _plain(loaded, weights / weights.sum())
    except DAMAGES:
        raise unknown from None
    buffer = io.BytesIO()
    torch.save(plain, buffer)
    write_file(Path(output), buffer.getbuffer())


def _plain(loaded: dict[str, Any], point: Tensor) -> dict[str, Any]:
    """Return a plain checkpoint of rsl_rl from one of a family, for a trade-off (m,)."""
    family = loaded[FAMILY]
    plain = {key: value for key, value in loaded.items() if key not in (FAMILY, RSL_RL)}
    for name, shapes in family["shapes"].items():
        state = family[name]
        bias, weight = state["family.bias"], state["family.weight"]
        features = mlp(len(point), HIDDEN, weight.shape[1])
        prefix = "family.features."
        inner = {k.removeprefix(prefix): x for k, x in state.items() if k.startswith(prefix)}
        features.load_state_dict(inner)
        with torch.no_grad():
            parts = (bias + weight @ features(point)).split([x.numel() for x in shapes.values()])
        named = zip(shapes.items(), parts, strict=True)
        parameters = {key: part.view(shape) for (key, shape), part in named}
        kept = NORMALIZER, "distribution."  # the latter if standard deviations are fixed
        others = {key: x for key, x in state.items() if key.startswith(kept)}
        critic = point if name == "critic" else None
        plain[f"{name}_state_dict"] = others | plain_state(parameters, family["std_name"], critic)
    groups = family["optimizer"]["param_groups"]
    states = [plain[f"{name}_state_dict"] for name in family["shapes"]]
    number = sum(not key.startswith(NORMALIZER) for state in states for key in state)
    plain["optimizer_state_dict"] = {
        "state": {},
        "param_groups": [{**groups[0], "params": [*range(number)]}],
    }
    return plain


def contents(actor: FamilyModel, config: Config, storage: FamilyStorage) -> dict[str, Any]:
    """Return the policies as a checkpoint of morlax; it shares the tensors of the family."""
    shapes = {name: value.shape[-1] for name, value in storage.observations.items()}
    privileged = shapes.get("critic", 0) if actor.obs_groups != ["critic"] else 0
    mean = torch.zeros(actor.obs_dim, dtype=torch.float32)
    deviation = torch.ones_like(mean)
    normalizer: Any = actor.obs_normalizer
    if actor.obs_normalization:
        mean, deviation = normalizer.mean.cpu(), normalizer.std.cpu() + normalizer.eps
    statistics = {
        "mean": pad(mean, (0, privileged)),
        "variance": pad(deviation.square(), (0, privileged), value=1.0),
        "scale": pad(1 / deviation, (0, privileged), value=1.0),
        "count": torch.ones((), dtype=torch.float64),
    }
    task = Task(
        objectives=tuple(config.task.objectives),
        observation_size=actor.obs_dim,
        action_size=storage.actions.shape[-1],
        privileged_size=privileged,
    )
    return {
        "format": FORMAT,
        "config": config.model_dump(mode="json"),
        "environment": task.model_dump(mode="json"),
        "policy": {
            **{f"actor.{name}": value for name, value in actor.family.state_dict().items()},
            **{f"observation_normalizer.{name}": value for name, value in statistics.items()},
        },
    }


def compact(state: dict[str, Any]) -> dict[str, Any]:
    """Return Adam's state without first moments, and with factors of the second ones.

    Second moments of a matrix are saved as the means of its rows and columns, whose outer product
    stands for it (Adafactor, Shazeer & Stern, ICML 2018, section 3).
    """
    rows = {}
    for index, row in state["state"].items():
        squares = row["exp_avg_sq"]
        factors = [squares.mean(1), squares.mean(0)] if squares.ndim == 2 else [squares]
        rows[index] = {"step": row["step"], "factors": [x.bfloat16() for x in factors]}
    return {**state, "state": rows}


def expanded(state: dict[str, Any]) -> dict[str, Any]:
    """Return a state for Adam from what `compact` returned."""
    rows = {}
    for index, row in state["state"].items():
        squares, *columns = (x.float() for x in row["factors"])
        for column in columns:
            squares = torch.outer(squares, column / column.mean().clamp(min=1e-30))
        rows[index] = {"step": row["step"], "exp_avg": 0 * squares, "exp_avg_sq": squares}
    return {**state, "state": rows}
