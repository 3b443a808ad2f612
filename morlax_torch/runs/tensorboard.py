"""The TensorBoard events of a run. docs/training.md lists the tags."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from ..configuration.config import changed, flat
from ..configuration.files import read_yaml
from ..envs.naming import title
from .hardware import FILE as HARDWARE
from .progress import Evaluation


class Events:
    """Writes the events of one session of a run; earlier ones are dropped from `purge_step` on."""

    def __init__(self, folder: Path, purge_step: int | None):
        self._folder, self._writer = folder, SummaryWriter(str(folder), purge_step=purge_step)
        self._has_hyperparameters = False
        for file in ("config.yaml", HARDWARE):
            lines = (folder / file).read_text().splitlines()
            tag, text = file.removesuffix(".yaml"), "\n".join(f"    {line}" for line in lines)
            self._writer.add_text(tag, text)

    def log_metrics(self, metrics: Mapping[str, float], env_steps: int) -> None:
        for name, value in metrics.items():
            self._writer.add_scalar(f"train/{name}", value, env_steps)

    def log_evaluation(self, evaluation: Evaluation, task: str, number: int) -> None:
        """Write an evaluation of a `task`, which is the `number`-th of the run, from 0 on."""
        steps = evaluation.env_steps
        curves = {
            **{f"front/{name}": value for name, value in evaluation.indicators.items()},
            "time/train_seconds": evaluation.train_seconds,
            "time/total_seconds": evaluation.total_seconds,
        }
        if not self._has_hyperparameters:
            self._log_hyperparameters(curves)
            self._has_hyperparameters = True
        for tag, value in curves.items():
            self._writer.add_scalar(tag, value, steps)
        # after ten evaluations, each with pictures is a tenth later than the last, so that a long
        # run stays small
        scales = [int(math.log(max(1, each), 1.1)) for each in (number - 1, number)]
        if number < 10 or scales[0] < scales[1]:
            from ..evaluation import figures  # matplotlib loads slowly

            name = f"{title(task)} after {steps / 1e6:.1f} M steps"
            for tag, draw in (("front", figures.front_figure), ("returns", figures.returns_figure)):
                image = figures.pixels(draw(evaluation.front, name))
                self._writer.add_image(f"figures/{tag}", image, steps, dataformats="HWC")
        self._writer.flush()

    def _log_hyperparameters(self, tags: Iterable[str]) -> None:
        """Fill the HPARAMS tab, first with options that differ from the task's config."""
        values = read_yaml(self._folder / "config.yaml")
        first = changed(values)
        ordered = sorted(flat(values).items(), key=lambda item: item[0] not in first)
        config = {name: _shown(value) for name, value in ordered if value != {}}
        # `add_hparams` would write to a folder of its own, which TensorBoard shows as another run
        experiment, session, _ = hparams(config, dict.fromkeys(tags, 0.0))
        assert self._writer.file_writer is not None
        for summary in (experiment, session):
            self._writer.file_writer.add_summary(summary)

    def close(self) -> None:
        self._writer.close()


def _shown(value: Any) -> str | float:
    """Return a finite number or text as it is, other values as JSON."""
    plain = isinstance(value, str) or (type(value) in (int, float) and math.isfinite(value))
    return value if plain else json.dumps(value)
