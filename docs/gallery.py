"""Write the section of shipped policies in tasks.md, and their images: python docs/gallery.py"""

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from morlax_torch import envs
from morlax_torch.configuration.config import Config, load_config
from morlax_torch.configuration.files import task_values
from morlax_torch.evaluation import figures
from morlax_torch.runs.loading import SHIPPED, find_run, load, load_front
from morlax_torch.runs.progress import History
from morlax_torch.viewers.filming.recording import record

DOCS = Path(__file__).parent
RESULTS = DOCS.parent / "benchmarks" / "results"
HEADING = "## Shipped policies\n"
ABOUT = """
The package ships one hypernetwork each for ant, bruce, cheetah, cheetah3, hopper, humanoid and
walker, and a [Go1 and two G1s of mjlab](mjlab.md). Commands accept a name in place of a run, and
`morlax_torch.load("ant")` loads one. Each front shows the returns of 512 trade-offs, each strip a
row for every objective alone and one for all equally, in equal steps of time. `docs/gallery.py`
writes this section.
"""
TASK = """
### {name}: {objectives}

Hypervolume {volume:.3e}, trained on {device} for {steps:.1f} M environment steps:

```sh
{command}
```

![Front of {name}](gallery/{name}-front.png)

![Film strip of {name}](gallery/{name}-strip.png)
"""


def command(config: Config) -> str:
    """Return the training command of a config: only options that differ from the task's config."""
    place = (config.device or "cuda").split(":")[0]
    defaults = load_config(task_values(config.env, place)).model_dump()
    options = [f"--env {config.env}", f"--device {place}"]

    def compare(values: dict[str, Any], defaults: dict[str, Any], prefix: str) -> None:
        for key, value in values.items():
            name = f"{prefix}{key.replace('_', '-')}"
            if isinstance(value, dict) and prefix == "":
                compare(value, defaults[key], f"{name}.")
            elif value == defaults[key] or name in ("device", "backend", "target"):
                continue
            elif isinstance(value, bool):
                options.append(f"--{name}" if value else f"--{prefix}no-{name[len(prefix) :]}")
            else:
                words = map(str, value) if isinstance(value, tuple) else [str(value)]
                options.append(" ".join([f"--{name}", *words]))

    compare(config.model_dump(), defaults, "")
    return " ".join(["morlax train", *options])


def examples() -> None:
    """Write the figures that evaluation.md explains, and BRUCE's front."""
    found = {name: load_front(name) for name in ("cheetah", "cheetah3", "bruce")}
    for name, front in found.items():
        m = len(front.objectives)
        for kind, draw in (("front", figures.front_figure), ("returns", figures.returns_figure)):
            figures.save(draw(front, name), DOCS / "figures" / f"{kind}-{m}", ("png",))
    parallel = figures.parallel_figure(found["bruce"], "bruce")
    figures.save(parallel, DOCS / "figures" / "parallel", ("png",))
    flat = found["cheetah3"]
    flat = flat._replace(
        objectives=flat.objectives[:2],
        tradeoffs=flat.tradeoffs[:, :2],
        returns=flat.returns[:, :2],
        reference_point=flat.reference_point[:2],
    )
    both = {"cheetah": found["cheetah"], "cheetah3, without its height": flat}
    figures.save(figures.fronts_figure(both, "two families"), DOCS / "figures" / "fronts", ("png",))
    curves = figures.hypervolume_figure(seeds("hopper"), True, "hopper, three seeds")
    figures.save(curves, DOCS / "figures" / "hypervolume", ("png",))


def seeds(task: str) -> dict[str, History]:
    """Return MORLAX's training curves of the comparison by seed."""
    with (RESULTS / "comparison-h100.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    kinds = ("task", "method", "evaluation"), (task, "MORLAX", "training")
    rows = [row for row in found if tuple(map(row.get, kinds[0])) == kinds[1]]
    names = ("env_steps", "train_seconds", "hypervolume")
    return {
        k: History(
            *(np.array([float(row[name]) for row in rows if row["seed"] == k]) for name in names)
        )
        for k in sorted({row["seed"] for row in rows})
    }


def shrink(path: Path) -> None:
    """Reduce a picture to 256 colors, which takes less than half the bytes."""
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(
            256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
        )
    few.save(path, optimize=True)


def main() -> None:
    examples()
    text = ABOUT
    for name in sorted({folder.name for folder in SHIPPED.iterdir()} & set(envs.names())):
        folder, policy = find_run(name), load(name)
        front = load_front(name)
        history = History.load(folder / "metrics.csv")
        figure = figures.front_figure(front, f"{name}, 512 trade-offs")
        figures.save(figure, DOCS / "gallery" / f"{name}-front", ("png",))
        strip = DOCS / "gallery" / f"{name}-strip.png"
        record(policy, strip, seconds=3.0, width=240, height=180, pictures=7)
        on_cpu = policy.config.device == "cpu"
        text += TASK.format(
            name=name,
            objectives=", ".join(policy.objectives),
            volume=front.hypervolume,
            steps=history.env_steps[-1] / 1e6,
            device="two CPU cores" if on_cpu else "one NVIDIA H200",
            command=command(policy.config),
        )
    page = DOCS / "tasks.md"
    before, _, _ = page.read_text().partition(HEADING)
    page.write_text(before + HEADING + text)
    for picture in (*DOCS.glob("gallery/*.png"), *DOCS.glob("figures/*.png")):
        shrink(picture)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    main()
