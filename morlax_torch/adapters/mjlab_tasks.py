"""Twins of mjlab's tasks that train a front: `train Pareto-Velocity-Flat-Unitree-Go1`.

mjlab imports this module by its entry point `mjlab.tasks`, and then lists them beside its own.
"""

from dataclasses import dataclass, field, fields, replace

from mjlab.rl import RslRlPpoAlgorithmCfg  # pyright: ignore[reportMissingImports]
from mjlab.tasks import registry  # pyright: ignore[reportMissingImports]

from ..envs.bridges.mjlab.worlds import add_terms
from .pareto_options import ParetoOptions

Group = dict[str, float]
DEFAULTS = ParetoOptions.model_fields

# factors on the terms as mjlab pays them; one that it does not pay has a weight of one
EFFORT: dict[str, Group] = {
    "Go1": {"is_alive": 3.75, "electrical_power_cost": -0.075, "joint_torques_l2": -0.003},
    "G1": {"is_alive": 3.0, "electrical_power_cost": -0.01, "joint_torques_l2": -0.0004},
}
OTHERS: dict[str, dict[str, Group]] = {
    "Velocity": {
        "tracking": {"track_*": 3.0},
        "smoothness": {"is_alive": 1.0, "action_rate_l2": 2.0, "foot_slip": 2.0},
    },
    "Tracking": {
        "tracking": {"motion_*": 3.0},
        "smoothness": {"is_alive": 1.0, "action_rate_l2": 2.0, "joint_limit": 2.0},
    },
}


@dataclass
class ParetoPpoCfg(RslRlPpoAlgorithmCfg):
    """The options of `ParetoPPO`, which `ParetoOptions` explains."""

    class_name: str = "morlax_torch.rsl_rl:ParetoPPO"
    objectives: dict[str, dict[str, float]] = field(default_factory=dict)
    guide: dict[str, float] = field(default_factory=dict)
    tradeoffs: int = DEFAULTS["tradeoffs"].default
    features: int = DEFAULTS["features"].default
    evaluation_worlds: int = DEFAULTS["evaluation_worlds"].default
    reference_point: tuple[float, ...] = ()
    task: str = ""


def register(task: str, objectives: dict[str, Group]) -> None:
    """Register the twin of a task of mjlab, whose policies all learn from its whole reward."""
    rl = registry.load_rl_cfg(task)
    ppo = {option.name: getattr(rl.algorithm, option.name) for option in fields(rl.algorithm)}
    ppo["class_name"] = ParetoPpoCfg.class_name
    guide, env = {"*": 1.0}, f"mjlab:{task}"
    algorithm = ParetoPpoCfg(**ppo, objectives=objectives, guide=guide, task=env)
    configs = [registry.load_env_cfg(task, play=play) for play in (False, True)]
    for config in configs:
        add_terms(config)
    twin = replace(rl, algorithm=algorithm, experiment_name=f"{rl.experiment_name}_pareto")
    name, runner = task.replace("Mjlab", "Pareto", 1), registry.load_runner_cls(task)
    registry.register_mjlab_task(name, *configs, twin, runner)


for name in registry.list_tasks():
    _, kind, *words = name.split("-")
    robot = next((word for word in words if word in EFFORT), None)
    if kind in OTHERS and robot:
        register(name, {**OTHERS[kind], "effort": EFFORT[robot]})
