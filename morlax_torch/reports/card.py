"""The decision card: why a trade-off was chosen, and what its policy does; one HTML file."""

from collections.abc import Mapping, Sequence
from html import escape

from ..evaluation.requirements import Choice, Requirements
from ..runs.choosing import CONDITIONS, Trial
from .html import document, facts, number, row, scrolled, table


def card(
    task: str,
    choice: Choice,
    trials: Mapping[str, Trial],
    about: Mapping[str, str],
    commands: Sequence[str],
    strip: bytes | None = None,
) -> str:
    """Return the card as HTML, which prints on a page or two.

    Args:
        task: its name.
        choice: what was chosen.
        trials: the choice under other conditions, by their names.
        about: checkpoint and the like, by name.
        commands: command lines that use the choice.
        strip: film strip as PNG (None: leave it out).
    """
    required, names = choice.required, choice.required.names
    wanted = " and ".join(
        f"{'at least' if limit.sign > 0 else 'at most'} {number(limit.level)} of "
        f"{names[limit.index]}"
        for limit in required.limits
    )
    asked = f"As much {names[required.maximized]} as possible" + (wanted and f", with {wanted}")
    weights = ", ".join(
        f"{name} {weight:.1%}" for name, weight in zip(choice.returns, choice.tradeoff, strict=True)
    )
    parts = [
        f"<h1>{escape(task)}: a policy for a requirement</h1>",
        f'<p class="verdict">{escape(asked)}.<br>The trade-off {escape(weights)}.</p>',
        "" if strip is None else f"<figure>{scrolled('film strip', 'png', strip)}</figure>",
        "<h2>Result</h2>",
        _values(choice),
        f"<p>{escape(_cost(choice))}</p>",
        "<h2>Under other conditions</h2>",
        _trials(trials, required),
        f"<p>{escape(_kept(trials, required))}</p>",
        "<h2>Where it comes from</h2>",
        facts(about),
        "<h2>Use it</h2>",
        f"<pre>{escape(chr(10).join(commands))}</pre>",
    ]
    return document(f"{task}: {asked}", parts)


def _values(choice: Choice) -> str:
    required = choice.required
    rows = [row("th", ["value", "required", "promised", "simulated", "margin", ""])]
    for index in required.used:
        name = required.names[index]
        limits = [limit.shown(",.4g") for limit in required.limits if limit.index == index]
        promised = number(choice.promised[name]) if name in choice.promised else ""
        margin = f"{choice.margins[name]:+.4g}" if limits else ""
        value = number(choice.values[index])
        rows.append(row("td", [name, " and ".join(limits), promised, value, margin, ""]))
    return table(rows, "facts")


def _cost(choice: Choice) -> str:
    required = choice.required
    if not required.limits:
        return "Nothing is required."
    best = number(choice.values[required.maximized] + choice.cost)
    return (
        f"The requirements cost {number(choice.cost)} of "
        f"{required.names[required.maximized]}, which reaches {best} without them. "
        f"{choice.simulated} trade-offs were simulated."
    )


def _trials(trials: Mapping[str, Trial], required: Requirements) -> str:
    names = [required.names[index] for index in required.used]
    rows = [row("th", ["condition", *names, "falls", "keeps all", ""])]
    for name, trial in trials.items():
        told = "yes" if _keeps(trial, required) else "no"
        values = map(number, trial.values[required.used])
        rows.append(row("td", [name, *values, f"{trial.falls:.0%}", told, ""]))
    return table(rows, "facts")


def _kept(trials: Mapping[str, Trial], required: Requirements) -> str:
    episodes = max(trial.episodes for trial in trials.values())
    means = f"Means over up to {episodes} episodes each. A fall breaks every requirement."
    left = [name for name in CONDITIONS if name not in trials]
    if left:
        means += f" Left out, because this task cannot vary them: {', '.join(left)}."
    missed = [name for name, trial in trials.items() if not _keeps(trial, required)]
    if not required.limits:
        return means
    if not missed:
        return f"{means} The requirements are kept under every condition."
    return f"{means} The requirements are not kept with {', '.join(missed)}."


def _keeps(trial: Trial, required: Requirements) -> bool:
    """Return whether every requirement is kept; a fall breaks all of them."""
    return trial.falls == 0 and bool(required.kept(trial.values[None])[0])
