"""Draw the three pictures of the docs: `python docs/site/pictures.py` writes docs/figures/*.svg.

Each picture is a white card, which suits light and dark pages alike.
"""

import argparse
from pathlib import Path

FIGURES = Path(__file__).resolve().parents[1] / "figures"
INK, GRAY, PALE, LINE = "#1d2733", "#66727f", "#f3f5f7", "#c9d1d9"
CLUSTERS = ("#1f6fb4", "#5b8f9c", "#a98f62", "#e07b28")  # from one objective to the other
WEIGHTS = ("(1, 0)", "(0.7, 0.3)", "(0.2, 0.8)", "(0, 1)")


def text(x: float, y: float, words: str, size: int = 13, color: str = INK, **style: str) -> str:
    named = "".join(f' {key.replace("_", "-")}="{value}"' for key, value in style.items())
    return f'<text x="{x}" y="{y}" font-size="{size}" fill="{color}"{named}>{words}</text>'


def box(x: float, y: float, width: float, height: float, fill: str, line: str = "none") -> str:
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="4" fill="{fill}" '
        f'stroke="{line}"/>'
    )


def arrow(x: float, y: float, to: float, color: str = GRAY) -> str:
    head = f"M{to - 7},{y - 4} L{to},{y} L{to - 7},{y + 4} z"
    return f'<path d="M{x},{y} H{to - 6}" stroke="{color}"/><path d="{head}" fill="{color}"/>'


def card(width: int, height: int, title: str, parts: list[str]) -> str:
    """Return an SVG of parts on a white card."""
    frame = (
        f'<rect x="0.5" y="0.5" width="{width - 1}" height="{height - 1}" rx="8" fill="#ffffff" '
        f'stroke="{LINE}"/>'
    )
    body = "\n".join([f"<title>{title}</title>", frame, *parts])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" font-family="system-ui, -apple-system, Segoe UI, Helvetica, Arial, '
        f'sans-serif">\n{body}\n</svg>\n'
    )


def worlds() -> str:
    """Return the picture of clusters of worlds that share a trade-off."""
    parts = [
        text(28, 34, "K trade-offs w", 13, GRAY),
        text(330, 34, "K policies", 13, GRAY),
        text(468, 34, "N worlds: K clusters of G = N/K", 13, GRAY),
        box(166, 52, 128, 176, PALE, LINE),
        text(230, 128, "hypernetwork", 13, text_anchor="middle", font_weight="600"),
        text(230, 150, "H(w) = M f(w) + b", 12, GRAY, text_anchor="middle"),
    ]
    for number, (color, weights) in enumerate(zip(CLUSTERS, WEIGHTS, strict=True)):
        y = 56 + 44 * number
        parts += [
            box(28, y, 96, 32, color),
            text(76, y + 21, weights, 13, "#ffffff", text_anchor="middle"),
            arrow(128, y + 16, 162),
            arrow(298, y + 16, 328),
            box(332, y, 92, 32, "#ffffff", color),
            text(378, y + 21, "π(a | s)", 13, color, text_anchor="middle"),
            arrow(428, y + 16, 464, color),
        ]
        parts += [box(468 + 28 * world, y + 4, 24, 24, color) for world in range(8)]
        if number in (0, 3):
            parts.append(text(700, y + 21, "corner", 12, GRAY))
    parts += [
        text(
            28,
            262,
            "Each world returns one reward per objective. Worlds of a cluster share one",
        ),
        text(28, 282, "trade-off and one policy. The next iteration draws new trade-offs."),
    ]
    return card(764, 304, "N worlds in K clusters, each with one trade-off", parts)


def run() -> str:
    """Return the picture of the files of a run."""
    columns = (
        (
            "what was trained",
            ("config.yaml", "the config; editable limits"),
            ("hardware.yaml", "the machines, in order"),
            ("task/, utility/", "copies of your own code"),
        ),
        (
            "what was measured",
            ("metrics.csv", "one row per evaluation"),
            ("events.out.tfevents", "curves for TensorBoard"),
            ("front.npz, fronts/", "of best.pt, and of training"),
        ),
        (
            "checkpoints/",
            ("best.pt", "largest hypervolume"),
            ("latest.pt", "all state, to resume"),
            ("latest.npz", "returns of latest.pt"),
        ),
    )
    parts = [text(28, 34, "runs/cheetah/20261123-064204-0/", 15, font_family="monospace")]
    for number, (heading, *files) in enumerate(columns):
        x = 28 + 240 * number
        parts += [box(x, 50, 226, 176, PALE, LINE), text(x + 14, 74, heading, 13, GRAY)]
        for row, (name, content) in enumerate(files):
            y = 98 + 46 * row
            parts += [
                text(x + 14, y, name, 13, font_family="monospace", font_weight="600"),
                text(x + 14, y + 18, content, 12, GRAY),
            ]
    mono = '<tspan font-family="monospace">{}</tspan>'.format
    parts += [
        text(28, 256, f"{mono('train --resume')} continues latest.pt."),
        text(
            28,
            278,
            f"{mono('explore')}, {mono('choose')}, {mono('record')}, {mono('export')} and "
            f"{mono('pack')} use best.pt.",
        ),
        text(28, 300, f"{mono('evaluate')} adds a report, indicators, front.csv and figures."),
    ]
    return card(764, 320, "The files of a run", parts)


def evaluation() -> str:
    """Return the picture of the rewards that an evaluation counts."""
    steps, failed, width = 12, 7, 38
    rows = (
        ("latched", "up to and including the first failed step"),
        ("paper", "all steps that are not failed, and the reset"),
        ("discounted", "as latched, by 0.99 per step, at most 500 steps"),
    )
    parts = [text(28, 34, "An episode in which the robot falls at one step and gets up again", 14)]
    for number, (name, rule) in enumerate(rows):
        base = 122 + 96 * number
        parts += [
            text(28, base - 26, name, 14, font_weight="600"),
            text(28, base + 20, rule, 12, GRAY),
            f'<path d="M140,{base} H{144 + (steps + 1) * width}" stroke="{LINE}"/>',
        ]
        for step in range(steps + 1):  # step 0 is the reset
            counts = {
                "latched": 1 <= step <= failed,
                "paper": step != failed,
                "discounted": 1 <= step <= failed,
            }[name]
            height = 44 * (0.93**step if name == "discounted" else 1.0)
            x = 148 + step * width
            fill, line = (CLUSTERS[0], "none") if counts else ("#ffffff", LINE)
            if counts and step == failed:
                fill = CLUSTERS[3]
            parts.append(box(x, base - height, width - 10, height, fill, line))
    base = 122 + 96 * 2 + 48
    parts += [
        text(162, 68, "reset", 12, GRAY, text_anchor="middle"),
        text(148 + failed * width + 14, 68, "failed", 12, CLUSTERS[3], text_anchor="middle"),
        text(148 + steps * width + 14, 68, "time limit", 12, GRAY, text_anchor="middle"),
        box(28, base - 1, 14, 14, CLUSTERS[0]),
        text(50, base + 11, "reward counts", 12),
        box(160, base - 1, 14, 14, CLUSTERS[3]),
        text(182, base + 11, "reward of the failed step counts", 12),
        box(400, base - 1, 14, 14, "#ffffff", LINE),
        text(422, base + 11, "does not count", 12),
    ]
    return card(700, 386, "Which rewards an evaluation counts", parts)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for picture in (worlds, run, evaluation):
        (FIGURES / f"{picture.__name__}.svg").write_text(picture())
