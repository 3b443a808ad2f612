"""Terminal output of `tune`: a line per trial, and a table of the best ones."""

import json
import shlex
import sys
import textwrap
from pathlib import Path
from typing import Any

from ...configuration.config import flat
from ...envs.naming import title
from ...tuning.results import FEWEST, importances
from ...tuning.study import Result, Study
from .cli import console, print_command
from .process import program

BEST = 5  # trials in the table
LABEL, VALUE = 24, 8  # widths of columns


class TuneDisplay:
    """Lines about a study, broken between words where the terminal ends."""

    def __init__(self, study: Study, folder: Path, trials: int):
        self._study, self._folder, self._trials = study, folder, trials

    def started(self, devices: str) -> None:
        """Print task, trials, options and storage, and the names of columns."""
        config, done = self._study.plan.base, len(self._study.results())
        options = ", ".join(name.rpartition(".")[2] for name in self._study.plan.space.parameters)
        ready = f", {done} of them done" if done else ""
        print_line(
            f"{title(config.env)}: {self._trials} trials of {config.max_seconds:g} s{ready}; "
            f"{devices}"
        )
        print_line(f"options: {options}")
        print_line(f"study {self._study.name} in {self._study.storage}")
        print_line(f"trial  state     {self._study.plan.main[:11]:>11}  ratio  changed options")

    def finished_by_worker(self, number: int) -> None:
        results = {result.number: result for result in self._study.results()}
        self.finished(self._study, results[number])

    def finished(self, study: Study, result: Result) -> None:
        if result.state == "failed":
            about = f"{result.number:5d}  {result.state:8}  "
            print_line(about + result.reason, indent=len(about))
        else:
            self._print(result, f"{result.state:8}  {result.indicators[study.plan.main]:11.4e}")

    def _print(self, result: Result, values: str) -> None:
        """Print the line of a trial that has not failed."""
        base = flat(self._study.plan.base.model_dump(mode="json"))
        changed = " ".join(
            f"{name.rpartition('.')[2]}={_short(value)}"
            for name, value in result.options.items()
            if value != base[name]
        )
        about = f"{result.number:5d}  {values}  {self._ratio(result):>5}  "
        print_line(about + (changed or "the base config"), indent=len(about))

    def _ratio(self, result: Result) -> str:
        base, main = self._study.base_result(), self._study.plan.main
        if base is None or base.indicators[main] <= 0:
            return "-"
        return f"{result.indicators[main] / base.indicators[main]:.2f}"

    def ended(self, continues: str) -> None:
        """Print the best trials and the next command; `continues` continues the search."""
        ranked, results = self._study.ranked(), self._study.results()
        print_line(f"{len(results)} of {self._trials} trials done")
        if ranked and len(self._study.plan.indicators) == 1:
            self._print_best(ranked)
        elif ranked:
            self._print_front(ranked)
        if len(results) < self._trials:
            print_command("continue", continues)
        if ranked:
            best = shlex.quote(str(self._folder / "best.yaml"))
            print_command("next", f"{program('train')} --config {best}")

    def _print_best(self, ranked: list[Result]) -> None:
        base = self._study.base_result()
        shown = [*([base] if base else []), *(r for r in ranked if not r.base)][: BEST + 1]
        shares = importances(self._study)
        names = ["base" if result.base else str(result.number) for result in shown]
        self._row("trial", names, "share" if shares else "")
        main = self._study.plan.main
        self._row(main, [_short(result.indicators[main]) for result in shown])
        self._row("ratio", [self._ratio(result) for result in shown])
        for option in sorted(shown[0].options, key=lambda name: -shares.get(name, 0)):
            if all(result.options[option] == shown[0].options[option] for result in shown):
                continue
            share = f"{shares[option]:.0%}" if option in shares else ""
            self._row(option, [_short(result.options[option]) for result in shown], share)
        if shares:
            print_line("share: how much an option decides whether a trial is among the best")
        else:
            print_line(f"the importance of options needs {FEWEST} trials")

    def _print_front(self, ranked: list[Result]) -> None:
        names = self._study.plan.indicators
        print_line("non-dominated trials:")
        print_line(f"trial  {'  '.join(f'{name:>16}' for name in names)}  ratio  changed options")
        for result in ranked:
            self._print(result, "  ".join(f"{result.indicators[name]:16.4e}" for name in names))

    def _row(self, label: str, values: list[str], share: str = "") -> None:
        cells = "".join(f" {value[: VALUE - 1]:>{VALUE - 1}}" for value in values)
        print_line(f"{label[:LABEL]:{LABEL}}{cells} {share:>5}".rstrip())


def print_line(text: str, indent: int = 0) -> None:
    """Print one line; on a terminal that is narrower, continue it below after `indent` spaces."""
    width = console.width if console.is_terminal else sys.maxsize
    later = " " * min(indent, console.width // 2)
    # a hyphen is part of a name
    lines = textwrap.wrap(text, width, subsequent_indent=later, break_on_hyphens=False)
    for line in [text] if len(text) <= width else lines:
        console.print(line, soft_wrap=True)


def _short(value: Any) -> str:
    if isinstance(value, float):
        text = f"{value:.3g}"
        mantissa, _, exponent = (text if len(text) < VALUE else f"{value:.2e}").partition("e")
        return f"{mantissa}e{int(exponent)}" if exponent else mantissa
    if isinstance(value, list):
        return ",".join(map(_short, value))
    return value if isinstance(value, str) else json.dumps(value)
