"""The report of an evaluation: one self-contained HTML file."""

from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources

from matplotlib.figure import Figure

from ..configuration.config import Config
from ..configuration.files import write_yaml
from ..evaluation.figures.colors import of_objectives
from ..evaluation.front import Front
from ..evaluation.representatives import representatives
from .chart import chart, svg
from .comparison import Evaluated, Quartiles
from .html import document, facts, image, number, row, scrolled, table

MEANINGS = {
    "hypervolume": "volume between the reference point and the front; higher is better",
    "hypervolume_approximate": "hypervolume, approximated by moocore; higher is better",
    "sparsity": "mean squared gap between neighbors on the front; lower is denser",
    "expected_utility": "mean over trade-offs of the best w · r on the front; higher is better",
    "cardinality": "number of non-dominated policies",
    "obedience": "share of trade-offs for which no other policy is clearly better than their own",
    "fall_rate": "share of episodes in which the robot failed",
    "blowup_rate": "share of episodes that left sane bounds, such as a state that is not finite",
    "igd_plus": "mean distance by which the front falls short of the reference front; 0 is best",
    "episode_length": "mean episode length in control steps",
}
POLICIES = (
    "The knee has the largest sum of returns, each scaled to its range on the front; the balanced "
    "policy has the trade-off closest to equal weights."
)


def report(
    title: str,
    verdict: str,
    about: str,
    command: str,
    found: Mapping[str, Evaluated],
    summary: Mapping[str, Quartiles],
    fronts: Mapping[str, Figure],
    figures: Sequence[tuple[str, Figure]],
    facts: Mapping[str, Mapping[str, str]],
    portrait: bytes | None = None,
) -> str:
    """Return the report as HTML, see `write`.

    Args:
        title: the task and its runs.
        verdict: how good the front is and what to do next.
        about: how they were evaluated, in a sentence or two.
        command: the command line of the evaluation.
        found: evaluations by run name.
        summary: measure -> quartiles over runs; empty for a single run.
        fronts: figure of each run's front, by run name.
        figures: captions and figures of everything else.
        facts: run -> name -> text.
        portrait: picture of the robot as PNG (None: leave it out).
    """
    objectives = next(iter(found.values())).front.objectives
    script = (resources.files(str(__package__)) / "page.js").read_text()
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="verdict">{escape(verdict)}</p>',
        _chips(objectives),
        *(_front(name, run.front, fronts[name]) for name, run in found.items()),
        "<h2>Figures</h2>",
        *(_picture(caption, figure) for caption, figure in figures),
        "<h2>Training and evaluation</h2>",
        _top(facts, portrait),
        f"<p>{escape(about)}</p>",
        f"<pre>{escape(command)}</pre>",
        *(_config(name, run.policy.config) for name, run in found.items()),
        "<h2>Indicators</h2>",
        _table({name: run.measures for name, run in found.items()}, summary),
    ]
    return document(title, parts, script)


def words(measure: str) -> str:
    return "IGD+" if measure == "igd_plus" else measure.replace("_", " ")


def meaning(measure: str) -> str:
    """Return a short explanation of a measure, empty if there is none."""
    ends = {"_min": "lowest return of any policy", "_max": "highest return of any policy"}
    return MEANINGS.get(measure) or ends.get(measure[-4:], "")


def _chips(objectives: Sequence[str]) -> str:
    dots = zip(objectives, of_objectives(len(objectives)), strict=True)
    chips = (f'<li><i style="background:{color}"></i>{escape(name)}</li>' for name, color in dots)
    return f'<ul class="chips">{"".join(chips)}</ul>'


def _front(name: str, front: Front, figure: Figure) -> str:
    """Return a front that a user can point at, and the table of its representative policies."""
    caption = "Returns of every trade-off, colored by trade-off."
    return f"<h2>{escape(f'Front: {name}')}</h2>\n{chart(caption, figure, front)}\n" + _policies(
        front
    )


def _policies(front: Front) -> str:
    heads = [f"weight of {name}" for name in front.objectives]
    heads += [*(f"{name} (return)" for name in front.objectives), *front.quantity_names]
    heads += [] if front.falls is None else ["fall rate"]
    shares = front.tradeoffs / front.tradeoffs.sum(1, keepdims=True)
    rows = [row("th", ["policy", *heads, ""])]
    for index, name in representatives(front).items():
        cells = [*(f"{share:.2f}" for share in shares[index]), *map(number, front.returns[index])]
        cells += [] if front.quantities is None else map(number, front.quantities[index])
        cells += [] if front.falls is None else [number(front.falls[index])]
        rows.append(row("td", [name, *cells, ""]))
    return f"{table(rows, 'facts')}\n<p>{POLICIES}</p>"


def _top(facts: Mapping[str, Mapping[str, str]], portrait: bytes | None) -> str:
    picture = "" if portrait is None else image("the robot under equal weights", "png", portrait)
    return f'<div class="top"><div>{_facts(facts)}</div>{picture}</div>'


def _facts(known: Mapping[str, Mapping[str, str]]) -> str:
    """Return the facts of one run as a list, and those of several as a table."""
    if len(known) == 1:
        return facts(next(iter(known.values())))
    rows = row("th", ["", *known, ""])
    for name in dict.fromkeys(name for run in known.values() for name in run):
        rows += row("td", [name, *(run.get(name, "") for run in known.values()), ""])
    return table([rows], "facts")


def _table(measured: Mapping[str, Mapping[str, float]], summary: Mapping[str, Quartiles]) -> str:
    heads = [*measured, *(("median", "quartiles") if summary else ())]
    rows = [row("th", ["", *heads, ""])]
    for name in next(iter(measured.values())):
        cells = [words(name), *(number(values[name]) for values in measured.values())]
        if summary:
            low, median, high = summary[name]
            cells += [number(median), f"{number(low)} - {number(high)}"]
        rows.append(row("td", [*cells, meaning(name)]))
    return table(rows)


def _picture(caption: str, figure: Figure) -> str:
    # an <img> keeps the ids of one SVG apart from those of the others
    picture = scrolled(caption, "svg+xml", svg(figure).encode())
    natural = f"--natural:{96 * figure.get_figwidth():.0f}px"
    named = f"<figcaption>{escape(caption)}</figcaption>"
    return f'<figure style="{natural}">{picture}{named}</figure>'


def _config(name: str, config: Config) -> str:
    text = escape(write_yaml(config))
    return f"<details><summary>{escape(name)}</summary><pre>{text}</pre></details>"
