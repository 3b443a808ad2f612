"""Writes gallery.md and its pictures from the policies that ship: python docs/gallery.py"""

from pathlib import Path

from morlax_torch import figures
from morlax_torch.evaluation import Front
from morlax_torch.history import History
from morlax_torch.policy import SHIPPED, find_run, load
from morlax_torch.record import record

DOCS = Path(__file__).parent
ABOUT = """# Gallery

The policies that come with the package: one hypernetwork for each of our own tasks.
`morlax_torch.load("ant")` acts with them, and `evaluate`, `record`, `explore` and `export` take
their names in place of a run's folder.

A front shows the returns of 512 trade-offs, one episode each; a film strip the first seconds under
each objective alone and under all of them alike. [How they were judged](evaluation.md).
This page is written by `docs/gallery.py`.
"""
TASK = """
## {name}: {objectives}

Hypervolume {volume:.3e}, trained on {device} for {steps:.1f} M environment steps:

```sh
python -m morlax_torch.train --env {name} --device {place} --max-env-steps {limit}
```

![Front of {name}, {objectives}, coloured by trade-off](gallery/{name}-front.png)

![Film strip of {name}: a row for each trade-off, time from left to right](gallery/{name}-strip.png)
"""


def main() -> None:
    text = ABOUT
    for name in sorted(folder.name for folder in SHIPPED.iterdir()):
        folder, policy = find_run(name), load(name)
        front = Front.load(folder / "front.npz")
        history = History.load(folder / "metrics.csv")
        drawn = figures.front_figure(front, f"{name}, 512 trade-offs")
        figures.save(drawn, DOCS / "gallery" / f"{name}-front", ("png",))
        strip = DOCS / "gallery" / f"{name}-strip.png"
        record(policy, strip, seconds=3.0, width=240, height=180, pictures=7)
        config = policy.config
        text += TASK.format(
            name=name,
            objectives=", ".join(policy.objectives),
            volume=front.hypervolume,
            steps=history.env_steps[-1] / 1e6,
            device="two CPU cores" if config.device == "cpu" else "one NVIDIA H200",
            place="cpu" if config.device == "cpu" else "cuda",
            limit=config.max_env_steps,
        )
    (DOCS / "gallery.md").write_text(text)


if __name__ == "__main__":
    main()
