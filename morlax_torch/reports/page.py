"""The report of an evaluation: one self-contained HTML file."""

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape

import matplotlib as mpl
from matplotlib.figure import Figure

from ..colors import of_objectives
from ..configuration.config import Config
from ..configuration.files import write_yaml
from ..evaluation.figures.style import FILES
from .comparison import Evaluated, Quartiles

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
NARROW = 16  # characters that fit into a column of facts
STYLE = """
:root { color-scheme: light dark; --ink: #1c2024; --paper: #fdfdfc; --faint: #6b737b;
  --line: #d9dde1 }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e7ea; --paper: #16191c; --faint: #8f979f; --line: #363c42 }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 68rem; margin: 2.5rem auto; padding: 0 1.2rem; overflow-wrap: anywhere }
h1 { font-size: 1.7rem; line-height: 1.2 } h2 { font-size: 1.2rem; margin-top: 2.4rem }
.top { display: flex; flex-wrap: wrap; gap: 1.2rem 2.4rem; align-items: flex-start }
.top > div { flex: 1 1 20rem; min-width: 0 }
.top img { flex: 0 1 auto; width: 26rem; max-width: 100% }
.chips { display: flex; flex-wrap: wrap; gap: .4rem 1.2rem; margin: 0 0 1rem; padding: 0 }
.chips li { list-style: none } .chips i { display: inline-block; width: .8em; height: .8em;
  border-radius: 50%; margin-right: .4em }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(9rem, 1fr)); gap: .8rem 1.2rem;
  margin: 0 }
dl .wide { grid-column: span 2 }
dt { color: var(--faint); font-size: .85rem } dd { margin: 0; font-weight: 600 }
.scroll { overflow-x: auto }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
th, td { padding: .3rem .9rem .3rem 0; text-align: right; border-bottom: 1px solid var(--line);
  white-space: nowrap }
.facts td.words { display: none }
.facts td { white-space: normal; min-width: 8rem; overflow-wrap: normal }
th:first-child, td:first-child, td.words { text-align: left }
td.words { color: var(--faint); white-space: normal; min-width: 16rem; overflow-wrap: normal }
pre { overflow-x: auto; padding: .8rem 1rem; border: 1px solid var(--line); border-radius: 6px;
  font-size: .85rem; white-space: pre-wrap }
figure { margin: 1.2rem 0 2rem } figcaption { color: var(--faint); font-size: .92rem }
img { max-width: 100%; background: white; border-radius: 6px }
@media (max-width: 40rem) {
  body { margin: 1.2rem auto; padding: 0 .9rem }
  td.words { min-width: 8.5rem; font-size: .8rem; line-height: 1.35 }
  th, td { padding-right: .6rem }
  td:first-child { white-space: normal; min-width: 6rem; overflow-wrap: normal }
  figure img { max-width: none; width: min(var(--natural), 38rem) }
}
"""


def report(
    title: str,
    about: str,
    command: str,
    found: Mapping[str, Evaluated],
    summary: Mapping[str, Quartiles],
    figures: Sequence[tuple[str, Figure]],
    facts: Mapping[str, Mapping[str, str]],
    portrait: bytes | None = None,
) -> str:
    """Return the report as HTML.

    Args:
        title: the task and its runs.
        about: how they were evaluated, in a sentence or two.
        command: the command line of the evaluation.
        found: evaluations by run name.
        summary: measure -> quartiles over runs; empty for a single run.
        figures: captions and figures.
        facts: run -> name -> text.
        portrait: picture of the robot as PNG (None: leave it out).
    """
    objectives = next(iter(found.values())).front.objectives
    parts = [
        f"<h1>{escape(title)}</h1>",
        _top(facts, objectives, portrait),
        f"<p>{escape(about)}</p>",
        f"<pre>{escape(command)}</pre>",
        "<h2>Indicators</h2>",
        _table({name: run.measures for name, run in found.items()}, summary),
        "<h2>Figures</h2>",
        *(_picture(caption, figure) for caption, figure in figures),
        "<h2>Training configs</h2>",
        *(_config(name, run.policy.config) for name, run in found.items()),
    ]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def words(measure: str) -> str:
    return "IGD+" if measure == "igd_plus" else measure.replace("_", " ")


def meaning(measure: str) -> str:
    """Return a short explanation of a measure, empty if there is none."""
    ends = {"_min": "lowest return of any policy", "_max": "highest return of any policy"}
    return MEANINGS.get(measure) or ends.get(measure[-4:], "")


def number(value: float) -> str:
    return f"{value:,.4g}"


def _top(
    facts: Mapping[str, Mapping[str, str]], objectives: Sequence[str], portrait: bytes | None
) -> str:
    dots = zip(objectives, of_objectives(len(objectives)), strict=True)
    chips = (f'<li><i style="background:{color}"></i>{escape(name)}</li>' for name, color in dots)
    picture = "" if portrait is None else _image("the robot under equal weights", "png", portrait)
    return (
        f'<div class="top"><div><ul class="chips">{"".join(chips)}</ul>{_facts(facts)}</div>'
        f"{picture}</div>"
    )


def _facts(facts: Mapping[str, Mapping[str, str]]) -> str:
    """Return the facts of one run as a list, and those of several as a table."""
    if len(facts) == 1:
        items = ""
        for name, text in next(iter(facts.values())).items():
            wide = ' class="wide"' if len(text) > NARROW else ""
            items += f"<div{wide}><dt>{escape(name)}</dt><dd>{escape(text)}</dd></div>"
        return f"<dl>{items}</dl>"
    rows = _row("th", ["", *facts, ""])
    for name in dict.fromkeys(name for run in facts.values() for name in run):
        rows += _row("td", [name, *(run.get(name, "") for run in facts.values()), ""])
    return f'<div class="scroll"><table class="facts">{rows}</table></div>'


def _table(measured: Mapping[str, Mapping[str, float]], summary: Mapping[str, Quartiles]) -> str:
    heads = [*measured, *(("median", "quartiles") if summary else ())]
    rows = [_row("th", ["", *heads, ""])]
    for name in next(iter(measured.values())):
        cells = [words(name), *(number(values[name]) for values in measured.values())]
        if summary:
            low, median, high = summary[name]
            cells += [number(median), f"{number(low)} - {number(high)}"]
        rows.append(_row("td", [*cells, meaning(name)]))
    return f'<div class="scroll"><table>{"".join(rows)}</table></div>'


def _row(tag: str, cells: Sequence[str]) -> str:
    *numbers, meaning = (escape(cell) for cell in cells)
    inner = "".join(f"<{tag}>{cell}</{tag}>" for cell in numbers)
    return f'<tr>{inner}<td class="words">{meaning}</td></tr>\n'


def _picture(caption: str, figure: Figure) -> str:
    drawn = io.BytesIO()
    with mpl.rc_context(FILES):
        figure.savefig(drawn, format="svg", metadata={"Date": None})
    # an <img> keeps the ids of one SVG apart from those of the others
    image = _image(caption, "svg+xml", drawn.getvalue())
    natural = f"--natural:{96 * figure.get_figwidth():.0f}px"
    return (
        f'<figure style="{natural}"><div class="scroll">{image}</div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _image(about: str, kind: str, content: bytes) -> str:
    data = base64.b64encode(content).decode()
    return f'<img alt="{escape(about)}" src="data:image/{kind};base64,{data}">'


def _config(name: str, config: Config) -> str:
    text = escape(write_yaml(config))
    return f"<details><summary>{escape(name)}</summary><pre>{text}</pre></details>"
