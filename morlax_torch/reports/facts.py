"""The facts of a run that a report begins with."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

from ..configuration.config import Config
from ..evaluation.front import hypervolume_in
from ..runs.hardware import Machine
from ..runs.history import History


def facts(
    config: Config,
    history: History | None,
    measures: Mapping[str, float],
    machines: Sequence[Machine] = (),
) -> dict[str, str]:
    """Return facts by name, each as text.

    Args:
        config: that the run was trained with.
        history: of its training, if it is known.
        measures: of its evaluation.
        machines: that trained it, in order; empty if they are unknown.
    """
    found = {
        "algorithm": config.algorithm,
        "random seed": str(config.seed),
        "device": config.device or "unknown",
        "parallel worlds": f"{config.worlds:,}",
    }
    if history is not None:
        found["environment steps"] = steps(float(history.env_steps[-1]))
        found["training time"] = duration(float(history.train_seconds[-1]))
    name = hypervolume_in(measures)
    found[name.replace("_", ", ")] = f"{measures[name]:.4g}"
    if machines:
        found["trained on"] = in_order(machine.hardware() for machine in machines)
        found["trained with"] = in_order(machine.software() for machine in machines)
    return found


def in_order(names: Iterable[str]) -> str:
    """Join names, each as often as it follows another one."""
    return "; then ".join(name for name, _ in groupby(names))


def steps(number: float) -> str:
    """Format a number of environment steps, such as 8,192 or 12.5 M."""
    return f"{number:,.0f}" if number < 1e6 else f"{number / 1e6:,.1f} M"


def duration(seconds: float) -> str:
    """Format a time span, such as 42 s, 3 min 05 s or 2 h 10 min."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"
