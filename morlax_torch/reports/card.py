"""The decision card: why a trade-off was chosen, and what its policy does; one HTML file."""

from collections.abc import Mapping, Sequence

from ..evaluation.requirements import Choice
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

    `trials` are the choice under other conditions, and `origin` texts such as the checkpoint, both
    by name. `commands` are command lines that use the choice, `strip` is a film strip as PNG.
    """
    required, names = choice.required, choice.required.names
    # a fall breaks every requirement
    kept = {
        name: trial.falls == 0 and bool(required.kept(trial.values[None])[0])
        for name, trial in trials.items()
    }
    return rendered(
        "card.html",
        task=task,
        limits=[(limit.sign, number(limit.level), names[limit.index]) for limit in required.limits],
        maximized=names[required.maximized],
        weights=[
            f"{name} {weight:.1%}"
            for name, weight in zip(choice.returns, choice.tradeoff, strict=True)
        ],
        strip=strip and data_url("png", strip),
        values=choice.rows(",.4g"),
        cost=number(choice.cost),
        most=number(choice.values[required.maximized] + choice.cost),
        simulated=choice.simulated,
        conditions=["condition", *(names[i] for i in required.used), "falls", "keeps all"],
        trials=[
            [
                name,
                *map(number, trial.values[required.used]),
                f"{trial.falls:.0%}",
                "yes" if kept[name] else "no",
            ]
            for name, trial in trials.items()
        ],
        episodes=max(trial.episodes for trial in trials.values()),
        left_out=[name for name in CONDITIONS if name not in trials],
        missed=[name for name in trials if not kept[name]],
        origin=origin,
        commands=commands,
    )
