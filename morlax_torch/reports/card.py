"""The decision card: why a trade-off was chosen, and what its policy does; one HTML file."""

from collections.abc import Mapping, Sequence
from html import escape

from ..evaluation.requirements import Choice
from ..runs.trials import CONDITIONS, Trial, kept
from .html import document, facts, image, number, row, table


def card(
    task: str,
    choice: Choice,
    least: Mapping[str, float],
    maximize: str,
    trials: Mapping[str, Trial],
    about: Mapping[str, str],
    commands: Sequence[str],
    strip: bytes | None = None,
) -> str:
    """Return the card as HTML, which prints on a page or two.

    Args:
        task: its name.
        choice: what was chosen.
        least: required returns by objective.
        maximize: the maximized objective.
        trials: the choice under other conditions, by their names.
        about: checkpoint and the like, by name.
        commands: command lines that use the choice.
        strip: film strip as PNG (None: leave it out).
    """
    wanted = " and ".join(f"at least {number(value)} of {name}" for name, value in least.items())
    asked = f"As much {maximize} as possible" + (f", with {wanted}" if wanted else "")
    weights = ", ".join(
        f"{name} {weight:.1%}" for name, weight in zip(choice.returns, choice.tradeoff, strict=True)
    )
    parts = [
        f"<h1>{escape(task)}: a policy for a requirement</h1>",
        f'<p class="verdict">{escape(asked)}.<br>The trade-off {escape(weights)}.</p>',
        "" if strip is None else f"<figure>{image('film strip', 'png', strip)}</figure>",
        "<h2>Returns</h2>",
        _returns(choice, least),
        f"<p>{escape(_cost(choice, least, maximize))}</p>",
        "<h2>Under other conditions</h2>",
        _trials(trials, least, list(choice.returns)),
        f"<p>{escape(_kept(trials, least, list(choice.returns)))}</p>",
        "<h2>Where it comes from</h2>",
        facts(about),
        "<h2>Use it</h2>",
        f"<pre>{escape(chr(10).join(commands))}</pre>",
    ]
    return document(f"{task}: {asked}", parts)


def _returns(choice: Choice, least: Mapping[str, float]) -> str:
    rows = [row("th", ["objective", "required", "promised", "simulated", "margin", ""])]
    for name, value in choice.returns.items():
        limits = (
            [number(least[name]), f"{choice.margins[name]:+.4g}"] if name in least else ["", ""]
        )
        cells = [name, limits[0], number(choice.promised[name]), number(value), limits[1], ""]
        rows.append(row("td", cells))
    return table(rows, "facts")


def _cost(choice: Choice, least: Mapping[str, float], maximize: str) -> str:
    if not least:
        return "Nothing is required."
    best = number(choice.returns[maximize] + choice.cost)
    return (
        f"The requirements cost {number(choice.cost)} of {maximize}, which reaches {best} without "
        f"them. {choice.simulated} trade-offs were simulated."
    )


def _trials(trials: Mapping[str, Trial], least: Mapping[str, float], names: list[str]) -> str:
    rows = [row("th", ["condition", *names, "falls", "keeps all", ""])]
    for name, trial in trials.items():
        told = "yes" if kept(trial, names, least) else "no"
        rows.append(row("td", [name, *map(number, trial.returns), f"{trial.falls:.0%}", told, ""]))
    return table(rows, "facts")


def _kept(trials: Mapping[str, Trial], least: Mapping[str, float], names: list[str]) -> str:
    episodes = max(trial.episodes for trial in trials.values())
    means = f"Means over up to {episodes} episodes each."
    left = [name for name in CONDITIONS if name not in trials]
    if left:
        means += f" Left out, because this task cannot vary them: {', '.join(left)}."
    missed = [name for name, trial in trials.items() if not kept(trial, names, least)]
    if not least:
        return means
    if not missed:
        return f"{means} The requirements are kept under every condition."
    return f"{means} The requirements are not kept with {', '.join(missed)}."
