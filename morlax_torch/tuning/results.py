"""The results of a study: trials.csv, best.yaml, and which options matter."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock

from ..configuration.config import Config, load_config
from ..configuration.files import changes, task_values
from ..envs import resolve_device
from ..host.files import attempting, make_folder, write_file
from .storage import optuna, quiet
from .study import Result, Study

FEWEST = 10  # trials


def write_results(study: Study, folder: Path) -> None:
    """Write trials.csv and, once a trial is complete, best.yaml, or raise MorlaxError."""
    make_folder(folder)
    # processes must not replace newer files by older ones
    with attempting(f"write to {folder}"), FileLock(folder / ".lock"):
        write_file(folder / "trials.csv", _table(study))
        if best := study.ranked()[:1]:
            write_file(folder / "best.yaml", _best(study, best[0]))


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
            **{k: v if isinstance(v, str) else json.dumps(v) for k, v in result.options.items()},
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
    own = {"env": config.env, "algorithm": config.algorithm}
    tuned = load_config(task_values(config.env, device_type, config.algorithm))
    values = config.model_dump(mode="json", exclude={"device", "backend"})
    found = changes(tuned.model_dump(mode="json"), values)
    return {**(own if config.algorithm != "morlax" else {"env": config.env}), **found}


def importances(study: Study) -> dict[str, float]:
    """Return the share of each option in what makes good trials differ, the largest first.

    PED-ANOVA compares the options of the best trials with those of all. Only ranks count, so pruned
    trials count too, with what they had reached. Of several indicators, hypervolume counts. Empty
    if there are fewer than FEWEST trials.
    """
    trials = study.trials_with_options()
    if len(trials) < FEWEST:
        return {}
    main = study.plan.main
    with quiet():
        copy = optuna.create_study(direction="maximize" if study.plan.sign > 0 else "minimize")
        for trial in trials:
            given: Any = {"params": trial.params, "distributions": trial.distributions}
            value = trial.user_attrs["indicators"][main]
            copy.add_trial(optuna.trial.create_trial(**given, value=value))
        evaluator = optuna.importance.PedAnovaImportanceEvaluator()
        return optuna.importance.get_param_importances(copy, evaluator=evaluator)
