"""Writes gallery.md and its pictures from the policies that ship: python docs/gallery.py"""

from pathlib import Path
from typing import Any

from morlax_torch.config import Config, load_config, task_values
from morlax_torch.evaluation import figures
from morlax_torch.evaluation.front import Front
from morlax_torch.evaluation.history import History
from morlax_torch.record import record
from morlax_torch.runs.loading import SHIPPED, find_run, load

DOCS = Path(__file__).parent
ABOUT = """# Gallery

The policies that come with the package: one hypernetwork for each of our own tasks.
`morlax_torch.load("ant")` acts with them, and `evaluate`, `record`, `explore` and `export` take
their names in place of a run's folder.

A front shows the returns of 512 trade-offs, one episode each; a film strip the first seconds under
each objective alone and under all of them alike. [How they were judged](evaluation.md).
This page is written by `docs/gallery.py`.

Ant and walker have smaller networks than their configs ask for, to stay below a megabyte. Of
walker, cheetah and hopper the best of three seeds ships (hypervolumes from 7.13e6, 5.79e6 and
1.57e7), of ant the better of two (3.49e7). All were trained and judged on MuJoCo Warp. On C MuJoCo,
which a computer without a GPU uses, the ant's front has 2.6 % less hypervolume, since the two
simulators lay the frames of its contacts differently; that of the others is the same to 0.4 %.
Humanoid and BRUCE were trained before `ppo.anneal` also brought the normaliser of observations to
rest, so that their commands now train a little differently.
"""
TASK = """
## {name}: {objectives}

Hypervolume {volume:.3e}, trained on {device} for {steps:.1f} M environment steps:

```sh
{command}
```

![Front of {name}, {objectives}, coloured by trade-off](gallery/{name}-front.png)

![Film strip of {name}: a row for each trade-off, time from left to right](gallery/{name}-strip.png)
"""


def command(config: Config) -> str:
    """That makes such policies: the options that differ from what the task's config has."""
    place = (config.device or "cuda").split(":")[0]
    usual = load_config(task_values(config.env, place)).model_dump()
    options = [f"--env {config.env}", f"--device {place}"]

    def compare(values: dict[str, Any], usual: dict[str, Any], prefix: str) -> None:
        for key, value in values.items():
            name = f"{prefix}{key.replace('_', '-')}"
            if isinstance(value, dict) and prefix == "":
                compare(value, usual[key], f"{name}.")
            elif value == usual[key] or name in ("device", "backend"):
                continue
            elif isinstance(value, bool):
                options.append(f"--{name}" if value else f"--{prefix}no-{name[len(prefix) :]}")
            else:
                words = map(str, value) if isinstance(value, tuple) else [str(value)]
                options.append(" ".join([f"--{name}", *words]))

    compare(config.model_dump(), usual, "")
    return " ".join(["python -m morlax_torch.train", *options])


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
        on_cpu = policy.config.device == "cpu"
        text += TASK.format(
            name=name,
            objectives=", ".join(policy.objectives),
            volume=front.hypervolume,
            steps=history.env_steps[-1] / 1e6,
            device="two CPU cores" if on_cpu else "one NVIDIA H200",
            command=command(policy.config),
        )
    (DOCS / "gallery.md").write_text(text)


if __name__ == "__main__":
    main()
