"""Search learning rates and widths of every method with the same budget.

    python benchmarks/search_methods.py --seconds 15 --tasks cheetah hopper

Each method of the file is trained as it is, with every learning rate, and with every width of the
hidden layers of actor and critic, for the same time and with the same seeds. What a method sets
itself is not searched, and methods with a trainer of their own are left out. Shares of several
GPUs, killed commands and the report are as of compare.py. Writes

    OUTPUT/settings.yaml   all settings, as methods of compare.py
    OUTPUT/searched.yaml   the methods with the best setting of each task, for compare.py --methods

The best setting has the highest median over seeds of what counts in compare.py. Compare with other
seeds than those of the search.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import compare
import numpy as np
import tyro
import yaml
from compare_jobs import read_methods
from compare_report import Trained, read_runs

from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.config import flat
from morlax_torch.configuration.files import merged, read_yaml
from morlax_torch.host.files import write_file
from morlax_torch.host.torchrun import FIRST

Settings = dict[str, dict[str, Any]]  # name of the setting -> changes that are searched


def main(
    output: Path = Path("search"),
    tasks: tuple[str, ...] = ("cheetah", "hopper", "walker", "ant", "humanoid"),
    methods: Path = compare.METHODS,
    rates: tuple[float, ...] = (2.5e-4, 1e-3),
    widths: tuple[int, ...] = (64, 256),
    seeds: tuple[int, ...] = (100,),
    seconds: float = 15.0,
    env_steps: int | None = None,
    share: str = "0/1",
    device: str | None = None,
) -> None:
    """Train the settings that are missing, and write the best of those that are complete.

    Args:
        output: Folder of the runs and files.
        tasks: Tasks to search on.
        methods: YAML file of methods, see compare_methods.yaml.
        rates: Learning rates of Adam.
        widths: Widths of both hidden layers of actor and critic.
        seeds: Random seeds, one run of each setting per seed.
        seconds: Training time per run, in seconds.
        env_steps: Environment steps per run, instead of seconds.
        share: Train every N-th run from the K-th on, as K/N, with K from 0.
        device: cuda or cpu (None: CUDA if available).
    """
    read_methods(methods, seconds)  # refuses a mistake
    given = {name: values or {} for name, values in read_yaml(methods).items()}
    settings = {
        name: settings_of(name, values, rates, widths)
        for name, values in given.items()
        if "trainer" not in values
    }
    everything = {
        setting: {**_without_time(given[name]), **changes}
        for name, of_method in settings.items()
        for setting, changes in of_method.items()
    }
    output.mkdir(parents=True, exist_ok=True)
    _write(everything, output / "settings.yaml")
    compare.main(output, tasks, output / "settings.yaml", seeds, seconds, env_steps, share, device)
    if not FIRST:
        return
    runs, found = read_runs(output / "rows.csv"), dict(given)
    for name, of_method in settings.items():
        for task in dict.fromkeys(run.task for run in runs):
            setting = best(of_method, [run for run in runs if run.task == task])
            if setting is not None:
                console.print(f"{task}: {setting}")
                found[name] = merged(found[name], {"tasks": {task: of_method[setting]}})
    _write(found, output / "searched.yaml")


def settings_of(
    name: str, values: dict[str, Any], rates: Sequence[float], widths: Sequence[int]
) -> Settings:
    """Return a method as it is, and with each learning rate and width, unless it sets them."""
    own = {key for part in (values, *values.get("tasks", {}).values()) for key in flat(part)}
    layers = {width: [width, width] for width in widths}
    changes = {
        **{f"learning rate {rate:g}": {"ppo.learning_rate": rate} for rate in rates},
        **{f"width {w}": {"network.actor": x, "network.critic": x} for w, x in layers.items()},
    }
    searched = {title: change for title, change in changes.items() if not own.intersection(change)}
    return {name: {}, **{f"{name}, {title}": change for title, change in searched.items()}}


def best(settings: Settings, runs: Sequence[Trained]) -> str | None:
    """Return the setting of the highest median over runs of one task, None without any run."""
    scores = {name: [run.best for run in runs if run.method == name] for name in settings}
    medians = {name: float(np.median(values)) for name, values in scores.items() if values}
    return max(medians, key=lambda name: medians[name], default=None)


def _without_time(values: dict[str, Any]) -> dict[str, Any]:
    """Return a method without what would give it another budget."""
    return {key: value for key, value in values.items() if key not in ("seconds", "reference")}


def _write(methods: dict[str, Any], path: Path) -> None:
    write_file(path, yaml.safe_dump(methods, sort_keys=False))


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
