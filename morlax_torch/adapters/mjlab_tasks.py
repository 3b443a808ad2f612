"""Twins of mjlab's tasks that train a front: `train Pareto-Velocity-Flat-Unitree-Go1`.

mjlab imports this module by its entry point `mjlab.tasks`, and then lists them beside its own.
"""

from dataclasses import dataclass, field, replace
from typing import Any

from mjlab.rl import RslRlPpoAlgorithmCfg  # pyright: ignore[reportMissingImports]
from mjlab.tasks import registry  # pyright: ignore[reportMissingImports]

from ..envs.bridges.mjlab import tour  # noqa: F401 (registers its task)
from ..envs.bridges.mjlab.config import add_terms
from .pareto_options import ParetoOptions

Group = dict[str, float]
DEFAULTS = ParetoOptions.model_fields

# Factors on the terms as mjlab pays them; one that it does not pay has a weight of one. With the
# guide, the focus gives every term mjlab's own weight, and adds to being alive.
FOCUS = (0.5, 0.5, 0.0)
GUIDED = 0.4  # factor of the guide on a term that objectives have, too
TRADED = 2 * (1 - GUIDED)  # factor of such an objective
EFFORT: dict[str, Group] = {
    "Go1": {"is_alive": 1.5, "electrical_power_cost": -0.03, "joint_torques_l2": -0.0012},
    "G1": {"is_alive": 1.2, "electrical_power_cost": -0.004, "joint_torques_l2": -0.00016},
}
WARMUP = {"Go1": 150, "G1": 300}  # a humanoid learns to walk later
# tracking of a robot that stands (measured: 53 of the Go1, 56 of the G1); smoothness and effort of
# one that falls at once
REFERENCE_POINTS = {"Velocity": (55.0, 0.0, 0.0)}
OTHERS: dict[str, dict[str, list[str]]] = {
    "Velocity": {"tracking": ["track_*"], "smoothness": ["action_rate_l2", "foot_slip"]},
    "Tracking": {"tracking": ["motion_*"], "smoothness": ["action_rate_l2", "joint_limit"]},
}


@dataclass
class ParetoPpoCfg(RslRlPpoAlgorithmCfg):
    """The options of `ParetoPPO`, which `ParetoOptions` explains."""

    class_name: str = "morlax_torch.rsl_rl:ParetoPPO"
    objectives: dict[str, dict[str, float]] = field(kw_only=True)
    guide: dict[str, float] = field(kw_only=True)
    tradeoffs: int = DEFAULTS["tradeoffs"].default
    features: int = DEFAULTS["features"].default
    evaluation_worlds: int = DEFAULTS["evaluation_worlds"].default
    focus: tuple[float, ...] = ()
    warmup: int = DEFAULTS["warmup"].default
    reference_point: tuple[float, ...] = ()
    task: str = ""


def register(task: str, **options: Any) -> None:
    """Register the twin of a task of mjlab, with these options of `ParetoPPO`."""
    rl = registry.load_rl_cfg(task)
    values = {**vars(rl.algorithm), "class_name": ParetoPpoCfg.class_name}
    algorithm = ParetoPpoCfg(**values, **options, focus=FOCUS, task=f"mjlab:{task}")
    configs = [registry.load_env_cfg(task, play=play) for play in (False, True)]
    for config in configs:
        add_terms(config)
    twin = replace(rl, algorithm=algorithm, experiment_name=f"{rl.experiment_name}_pareto")
    name, runner = task.replace("Mjlab", "Pareto", 1), registry.load_runner_cls(task)
    registry.register_mjlab_task(name, *configs, twin, runner)


for name in registry.list_tasks():
    origin, kind, *words = (*name.split("-"), "")  # other packages name theirs as they like
    robot = next((word for word in words if word in EFFORT), None)
    if origin == "Mjlab" and kind in OTHERS and robot:
        terms = OTHERS[kind]
        objectives = {title: dict.fromkeys(terms[title], TRADED) for title in terms}
        objectives["smoothness"]["is_alive"] = GUIDED
        guide = {"*": 1.0} | {term: GUIDED for title in terms for term in terms[title]}
        register(
            name,
            objectives={**objectives, "effort": EFFORT[robot]},
            guide=guide,
            warmup=WARMUP[robot],
            reference_point=REFERENCE_POINTS.get(kind, ()),
        )
