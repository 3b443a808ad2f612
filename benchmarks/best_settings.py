"""Write the plan of a comparison from a search: every method with its best setting on each task.

    python benchmarks/best_settings.py --rows rows.csv --search benchmarks/plans/search.yaml \\
        --seeds 200 201 202 203 204 --output benchmarks/plans/comparison.yaml

The best setting has the highest mean hypervolume from noised starts, among those of most seeds.
"""

from collections.abc import Sequence
from pathlib import Path
from statistics import mean

import tyro
import yaml
from compare import Plan, volumes_of
from row_files import Row, read_rows

from morlax_torch import MorlaxError
from morlax_torch.commands.terminal import cli
from morlax_torch.configuration.files import read_yaml


def main(rows: Path, search: Sequence[Path], seeds: Sequence[int], output: Path) -> None:
    """Write the plan of a comparison.

    Args:
        rows: CSV file that compare.py has written for the searches.
        search: Plans of the searches.
        seeds: Seeds of the comparison; none that has chosen a setting.
        output: YAML file to write.
    """
    plans = [Plan(**read_yaml(path)) for path in search]
    if chosen_by := {seed for plan in plans for seed in plan.seeds} & set(seeds):
        raise MorlaxError(f"Seeds {sorted(chosen_by)} have chosen settings: report on others.")
    results = read_rows(rows)
    comparison = {"tasks": plans[0].tasks, "seeds": [*seeds], "seconds": plans[0].seconds}
    comparison["methods"] = {
        method: {**plan.methods[method], "tasks": best_settings(plan, method, results)}
        for plan in plans
        for method in plan.methods
    }
    names = ", ".join(path.name for path in search)
    head = f"# The best settings of {names}, written by best_settings.py.\n"
    output.write_text(head + yaml.safe_dump(comparison, sort_keys=False, default_flow_style=None))


def best_settings(plan: Plan, method: str, rows: Sequence[Row]) -> dict[str, dict[str, object]]:
    """Return the changes of a method's best setting on each task."""
    best = {}
    for task in plan.tasks:
        scores: dict[str, list[float]] = {}
        for (of_task, of_method, setting, _), volume in volumes_of(rows).items():
            if (of_task, of_method) == (task, method):
                scores.setdefault(setting, []).append(volume)
        if not scores:
            raise MorlaxError(f"No row of {method} on {task}: finish the search first.")
        ranked = sorted(scores, key=lambda name: (len(scores[name]), mean(scores[name])))
        best[task] = dict(plan.settings[ranked[-1]])  # a copy: else YAML writes anchors
    return best


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
