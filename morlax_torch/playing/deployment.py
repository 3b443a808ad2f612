"""Read an export: deploy.yaml, the model of the robot, and the policy's file."""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import yaml

from ..envs import MorlaxError
from ..files import exists, is_folder, read

SETTINGS, XML = "deploy.yaml", "robot.xml"


@dataclass
class Deployment:
    """An export that can be played: its settings, the model, and the file of the policy."""

    settings: dict[str, Any]  # deploy.yaml
    model: mujoco.MjModel
    policy: Path

    @property
    def own(self) -> dict[str, Any]:
        """The entries that unitree_rl_lab does not have."""
        return self.settings["morlax_torch"]

    @property
    def action(self) -> dict[str, Any]:
        return self.settings["actions"]["JointPositionAction"]

    @property
    def limits(self) -> list[list[float]]:
        """Range (low, high) of each number of the command: m/s, m/s, rad/s."""
        ranges = self.settings["commands"]["base_velocity"]["ranges"]
        return [ranges[axis] for axis in ("lin_vel_x", "lin_vel_y", "ang_vel_z")]


def open_export(path: Path) -> Deployment:
    """Open an export by its folder or the file of its policy.

    Raises:
        MorlaxError: a file is missing or damaged, or gains or the command are not known.
    """
    folder = path if is_folder(path) else path.parent
    if not exists(path):
        raise MorlaxError(f"there is no export {path}: morlax export writes one.")
    if not exists(folder / SETTINGS):
        raise MorlaxError(
            f"{folder} has no {SETTINGS}: morlax export writes one for policies whose actions are "
            "positions of joints, such as those of mjlab's velocity tasks."
        )
    try:
        settings = yaml.safe_load(read(folder / SETTINGS).decode())
        own, action = settings["morlax_torch"], settings["actions"]["JointPositionAction"]
        ids = action["joint_ids"] or range(len(own["joints"]))
        gains = list(zip(settings["stiffness"], settings["damping"], strict=True))
        missing = [own["joints"][i] for i in ids if None in gains[i]]
        moves = "base_velocity" in settings["commands"]
        policy = folder / own["policy"] if path == folder else path
        archive = folder / own["model"]
    except (KeyError, TypeError, IndexError, ValueError, yaml.YAMLError) as error:
        raise MorlaxError(
            f"{folder / SETTINGS} is damaged or incomplete ({type(error).__name__}): export the "
            "policy again."
        ) from None
    if missing:
        raise MorlaxError(
            f"{folder / SETTINGS} has no gains (null) for {', '.join(missing)}: write their "
            "stiffness and damping there."
        )
    if not moves:
        raise MorlaxError(f"{folder / SETTINGS} has no velocity command, which play needs.")
    return Deployment(settings, _model(archive), policy)


def _model(archive: Path) -> mujoco.MjModel:
    """Compile the model in a zip of robot.xml and its files."""
    try:
        with zipfile.ZipFile(io.BytesIO(read(archive, "model"))) as files:
            contents = {name: files.read(name) for name in files.namelist()}
        text = contents.pop(XML).decode()
        return mujoco.MjSpec.from_string(text, assets=contents).compile()
    except (KeyError, ValueError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(f"cannot load the model {archive}: {reason}.") from None
