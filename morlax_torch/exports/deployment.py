"""Files beside an exported policy, with which it drives a robot without this package."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from ..host.files import write_file
from ..host.version import __version__

if TYPE_CHECKING:
    from ..envs import Robot  # imports torch, which playing an export does without

SETTINGS, MODEL, MOTION = "deploy.yaml", "robot.zip", "motion{}.npz"
HEADER = "# Settings of a controller; every key is explained in morlax_torch's docs/export.md.\n"


def deploy(
    robot: "Robot",
    policy: Path,
    task: str,
    objectives: Sequence[str],
    tradeoff: Sequence[float] | None = None,
    slew: float | None = None,
) -> list[str] | None:
    """Write deploy.yaml, robot.zip and motions to follow beside the file of an exported policy.

    `tradeoff` (m,) is None if it is an input, and its weights change by at most `slew` per second.
    Returns what the files lack, in sentences; None, and no file is written, unless the robot's
    actions are positions of joints.
    """
    deployment = robot.deployment()
    if deployment is None:
        return None
    numbers = range(1, len(deployment.motions) + 1)
    motions = [MOTION.format("" if number == 1 else number) for number in numbers]
    ours = {
        "version": __version__,
        "task": task,
        "policy": policy.name,
        "model": MODEL if deployment.model else None,
        "motion": next(iter(motions), None),
        "objectives": objectives,
        "tradeoff": tradeoff,
        "slew": slew,
    }
    settings = {**deployment.settings, "morlax_torch": ours | deployment.settings["morlax_torch"]}
    # seven digits, as float32 has
    text = json.dumps(settings)
    settings = json.loads(text, parse_float=lambda digits: float(f"{float(digits):.7g}"))
    text = yaml.safe_dump(settings, default_flow_style=None, sort_keys=False, width=100)
    if deployment.model:
        write_file(policy.with_name(MODEL), deployment.model)
    for name, content in zip(motions, deployment.motions, strict=True):
        write_file(policy.with_name(name), content)
    write_file(policy.with_name(SETTINGS), HEADER + text)
    action, stiffness = settings["actions"]["JointPositionAction"], settings["stiffness"]
    driven = zip(action["joint_ids"] or range(len(stiffness)), action["joint_names"], strict=True)
    without = [name for index, name in driven if stiffness[index] is None]
    lacks = []
    if without:
        lacks.append(
            f"{SETTINGS} has no gains (null) for {', '.join(without)}, whose motors are not "
            "position actuators of the model."
        )
    if not deployment.model:
        lacks.append(f"{MODEL} is not written, because MuJoCo cannot write this scene as XML.")
    return lacks
