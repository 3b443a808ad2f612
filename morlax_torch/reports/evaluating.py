"""Evaluate runs, compare them, and write what was found."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from ..configuration.sections import Protocol
from ..envs import MorlaxError, resolve_device
from ..evaluation import pareto
from ..evaluation.evaluator import usual_tradeoffs
from ..evaluation.front import Front
from ..host.files import make_folder, unused
from ..host.phases import phase, within
from ..networks.policy import Policy
from ..runs import checkpoint, loading
from ..runs.hardware import read_machines
from ..runs.progress import History
from . import comparison
from .comparison import Evaluated
from .page import indicator_cells, words, write
from .verdict import verdict_of

MOST_COLUMNS = 3  # repeated runs shown in the terminal; the files list all of them, and quartiles


def evaluate_runs(
    runs: Sequence[str],
    typed: str,
    tradeoffs: int | None = None,
    protocol: Protocol | None = None,
    device: str | None = None,
    backend: str | None = None,
    seed: int = 0,
    seeds: int | None = None,
    reference: str | None = None,
    output: Path | None = None,
    trust: bool = False,
    env: str | None = None,
    portrait: Callable[[Policy], bytes | None] = lambda policy: None,
    show: Callable[[str | Table], None] = lambda part: None,
) -> tuple[dict[str, Evaluated], Path]:
    """Evaluate runs, and write fronts, figures, indicators and a report to the returned folder.

    `typed` is the command line, `portrait` draws a robot as PNG, and `show` gets the verdict and a
    table before anything is written. See `evaluate --help` for the other arguments.
    """
    for run in runs:
        loading.trust_run(run, trust, env)
    named = dict(zip(comparison.names(runs), runs, strict=True))
    policies = {name: loading.load(run, resolve_device(device)) for name, run in named.items()}
    protocol = comparison.check_comparable(policies, protocol)
    first, configs = next(iter(policies.values())), [p.config for p in policies.values()]
    if tradeoffs is None:
        tradeoffs = max(usual_tradeoffs(config, protocol) for config in configs)
    seeds = max(config.evaluation.seeds for config in configs) if seeds is None else seeds
    # damaged files, and a wrong output, are refused before the evaluation
    folders = {name: loading.find_run(run) for name, run in named.items()}
    curves = {name: run / "metrics.csv" for name, run in folders.items()}
    histories = {name: History.load(x) if x.is_file() else None for name, x in curves.items()}
    machines = {name: read_machines(run) for name, run in folders.items()}

    def evaluated(policy: Policy) -> Front:
        return loading.evaluate(policy, tradeoffs, protocol, device, backend, seed, seeds)

    target = reference_front(reference, policies, protocol, evaluated) if reference else None
    files = {name: loading.find_checkpoint(run) for name, run in named.items()}
    if output is not None:
        make_folder(output)
    fronts = {}
    for name, policy in policies.items():
        with within(name):
            fronts[name] = evaluated(policy)._replace(checkpoint=files[name].name)
    if target is None and len(fronts) > 1:
        target = pareto.front(np.concatenate([front.returns for front in fronts.values()]))
    evaluations = {}
    for name, run in named.items():
        measures = comparison.measures(fronts[name], target)
        facts = fronts[name], histories[name], measures, machines[name]
        evaluations[name] = Evaluated(run, policies[name], *facts)
    used = ", ".join(f"{front.checkpoint} of {name}" for name, front in fronts.items())
    for part in (verdict_of(evaluations), table(evaluations), f"evaluated: {used}"):
        show(part)
    changed = loading.is_changed(runs[0], first)
    as_trained = protocol == first.config.evaluation.protocol and not changed
    # the files in a run's folder are of best.pt, evaluated as in training
    folder, path = loading.own_folder(runs[0]), Path(runs[0])
    other = path.is_file() and path.parent.name == "checkpoints" and path.name != "best.pt"
    in_run = len(runs) == 1 and folder is not None and as_trained
    if in_run:  # a training run may have a better best.pt meanwhile: its front must stay
        newest = checkpoint.fingerprint(checkpoint.load(files[name]).agent)
        in_run = newest == fronts[name].fingerprint
    if output is not None:
        folder = output
    elif folder is None or other or not in_run:
        folder = unused(Path("evaluations") / time.strftime("%Y%m%d-%H%M%S"))
    source = reference or "the non-dominated points of all runs"
    values: dict[str, Any] = {
        "tradeoffs": tradeoffs,
        "seeds": seeds,
        "protocol": protocol,
        "device": resolve_device(device),
        "reference": "" if target is None else f"{source}, {len(target)} points",
        "command": typed,
        "portrait": portrait(first),
    }
    phase("writing the report")
    write(evaluations, folder, values)
    if output is None and in_run:
        for name, front in fronts.items():
            front.save(checkpoint.front_path(files[name]))  # where `load_front` looks
    return evaluations, folder


def reference_front(
    source: str,
    policies: Mapping[str, Policy],
    protocol: Protocol,
    evaluated: Callable[[Policy], Front],
) -> np.ndarray:
    """Return the non-dominated points (n, m) of a reference: of an .npz file, or of a run."""
    if source.endswith(".npz"):
        front = Front.load(Path(source))
    else:
        other = loading.load(source)
        comparison.check_comparable({**policies, source: other}, protocol)
        front = evaluated(other)
    objectives = next(iter(policies.values())).objectives
    if (front.objectives, front.protocol) != (objectives, protocol):
        raise MorlaxError(
            f"the reference {source} has the objectives {', '.join(front.objectives)} by the "
            f"protocol {front.protocol}, but the runs have {', '.join(objectives)} by {protocol}."
        )
    return front.returns[front.non_dominated]


def table(evaluations: Mapping[str, Evaluated]) -> Table:
    """Return the indicators as a table for the terminal: of each run, or of many repeats in all."""
    number = len(evaluations)
    heads, several = [*evaluations], comparison.repeated(evaluations)
    heads += [f"median of {number}", "quartiles"] * several
    columns = slice(number + several) if number <= MOST_COLUMNS else slice(number * several, None)
    table = Table("indicator", box=box.SIMPLE_HEAD)
    for head in heads[columns]:
        table.add_column(head, justify="right", overflow="fold")
    for name, cells in indicator_cells(evaluations).items():
        table.add_row(words(name), *cells[columns])
    return table
