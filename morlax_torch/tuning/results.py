"""The files of a study: trials.csv and best.yaml."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock

from ..configuration.config import Config, load_config
from ..configuration.files import changes, task_values
from ..envs import MorlaxError, resolve_device
from ..files import make_folder, replacing
from .study import Result, Study


def write_results(study: Study, folder: Path) -> None:
    """Write trials.csv and, once a trial is complete, best.yaml.

    Raises:
        MorlaxError: a file cannot be written.
    """
    make_folder(folder)
    try:
        with FileLock(folder / ".lock"):  # processes must not replace newer files by older ones
            _write(folder / "trials.csv", _table(study))
            best = study.ranked()[:1]
            if best:
                _write(folder / "best.yaml", _best(study, best[0]))
    except OSError as error:
        raise MorlaxError(f"cannot write to {folder}: {error.strerror or error}.") from None


def _write(path: Path, text: str) -> None:
    with replacing(path) as file:
        file.write(text.encode())


def _table(study: Study) -> str:
    measured = dict.fromkeys((*study.plan.indicators, study.plan.main))
    rows: list[dict[str, Any]] = [
        {
            "number": result.number,
            "state": result.state,
            "base": result.base,
            **{name: result.indicators.get(name, "") for name in measured},
            "train_seconds": round(result.train_seconds, 3),
            "env_steps": result.env_steps,
            "seeds": result.seeds,
            **{name: _text(value) for name, value in result.options.items()},
            "reason": result.reason,
        }
        for result in study.results()
    ]
    table = io.StringIO()
    if rows:
        writer = csv.DictWriter(table, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return table.getvalue()


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _best(study: Study, result: Result) -> str:
    place = resolve_device(result.config.device).type
    reached = f"{study.plan.main} {result.indicators[study.plan.main]:.4e}"
    seeds = f", the mean of {result.seeds} seeds" if result.seeds > 1 else ""
    return (
        f"# Trial {result.number} of {study.name}: {reached} "
        f"after {result.train_seconds:.1f} s of training{seeds}.\n"
        f"# morlax train --config best.yaml --device {place}\n"
        + yaml.safe_dump(_changes(result.config, place), sort_keys=False)
    )


def _changes(config: Config, device_type: str) -> dict[str, Any]:
    """Return the task and what a config changes in its tuned values."""
    own = {"env": config.env, "algorithm": config.algorithm}
    tuned = load_config(task_values(config.env, device_type, config.algorithm))
    values = config.model_dump(mode="json", exclude={"device", "backend"})
    found = changes(tuned.model_dump(mode="json"), values)
    return {**(own if config.algorithm != "morlax" else {"env": config.env}), **found}
