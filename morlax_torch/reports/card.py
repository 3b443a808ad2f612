"""The decision card: why a trade-off was chosen, and what its policy does; one HTML file."""

from collections.abc import Mapping, Sequence

from ..evaluation.requirements import Choice, Requirements
from ..runs.choosing import CONDITIONS, Trial
from .page import data_url, number, rendered


def card(
    task: str,
    choice: Choice,
    trials: Mapping[str, Trial],
    origin: Mapping[str, str],
    commands: Sequence[str],
    strip: bytes | None = None,
) -> str:
    """Return the card as HTML, which prints on a page or two.

    Args:
        task: its name.
        choice: what was chosen.
        trials: the choice under other conditions, by their names.
        origin: checkpoint and the like, by name.
        commands: command lines that use the choice.
        strip: film strip as PNG (None: leave it out).
    """
    required, names = choice.required, choice.required.names
    limits = " and ".join(
        f"{'at least' if limit.sign > 0 else 'at most'} {number(limit.level)} of "
        f"{names[limit.index]}"
        for limit in required.limits
    )
    return rendered(
        "card.html",
        task=task,
        wish=f"As much {names[required.maximized]} as possible" + (limits and f", with {limits}"),
        weights=", ".join(
            f"{name} {weight:.1%}"
            for name, weight in zip(choice.returns, choice.tradeoff, strict=True)
        ),
        strip=strip and data_url("png", strip),
        values=[_value(choice, index) for index in required.used],
        cost=_cost(choice),
        conditions=["condition", *(names[i] for i in required.used), "falls", "keeps all"],
        trials=[
            [
                name,
                *map(number, trial.values[required.used]),
                f"{trial.falls:.0%}",
                "yes" if _keeps(trial, required) else "no",
            ]
            for name, trial in trials.items()
        ],
        kept=_kept(trials, required),
        origin=origin,
        commands=commands,
    )


def _value(choice: Choice, index: int) -> list[str]:
    """Return a row of the result: a value, what is required, promised and simulated, the margin."""
    required, name = choice.required, choice.required.names[index]
    limits = [limit.shown(",.4g") for limit in required.limits if limit.index == index]
    promised = number(choice.promised[name]) if name in choice.promised else ""
    margin = f"{choice.margins[name]:+.4g}" if limits else ""
    return [name, " and ".join(limits), promised, number(choice.values[index]), margin]


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
