"""Open an export: deploy.yaml, the model of the robot, and the policy's file."""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import yaml
from pydantic import BaseModel, Field, ValidationError, model_validator

from ...envs import MorlaxError
from ...envs.errors import explained
from ...exports.deployment import SETTINGS
from ...host.files import read

Values = list[float]
Range = tuple[float, float]


# The entries of deploy.yaml that are used here; docs/export.md explains all of them.
class Ranges(BaseModel):
    lin_vel_x: Range
    lin_vel_y: Range
    ang_vel_z: Range


class BaseVelocity(BaseModel):
    ranges: Ranges


class Commands(BaseModel):
    base_velocity: BaseVelocity


class JointPositionAction(BaseModel):
    clip: list[Range] | None
    scale: Values
    offset: Values
    joint_ids: list[int] | None


class Actions(BaseModel):
    JointPositionAction: JointPositionAction


class Term(BaseModel):
    """A term of the observation."""

    params: dict[str, Any]
    clip: Range | None
    scale: Values
    history_length: int = Field(ge=1)


class Additions(BaseModel):
    """The entries that unitree_rl_lab does not have."""

    policy: str
    model: str | None
    objectives: list[str]
    slew: float | None = Field(gt=0)
    joints: list[str]
    default_joint_vel: Values
    observation_noise: Values


class Settings(BaseModel):
    step_dt: float = Field(gt=0)
    stiffness: list[float | None]
    damping: list[float | None]
    default_joint_pos: Values
    commands: Commands
    actions: Actions
    observations: dict[str, Term]
    morlax_torch: Additions

    @property
    def action(self) -> JointPositionAction:
        return self.actions.JointPositionAction

    @property
    def driven(self) -> list[int]:
        """The joint of each action."""
        ids = self.action.joint_ids
        return list(range(len(self.morlax_torch.joints))) if ids is None else ids

    @property
    def limits(self) -> list[Range]:
        """The range of each number of the command: m/s, m/s, rad/s."""
        ranges = self.commands.base_velocity.ranges
        return [ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z]

    @model_validator(mode="after")
    def _check(self) -> "Settings":
        additions, action, driven = self.morlax_torch, self.action, self.driven
        joints, terms = len(additions.joints), len(self.observations)
        lists = {
            "stiffness": (self.stiffness, joints),
            "damping": (self.damping, joints),
            "default_joint_pos": (self.default_joint_pos, joints),
            "default_joint_vel": (additions.default_joint_vel, joints),
            "scale": (action.scale, len(driven)),
            "offset": (action.offset, len(driven)),
            "clip": (action.clip, len(driven)),
            "observation_noise": (additions.observation_noise, terms),
        }
        for name, (values, count) in lists.items():
            if values is not None and len(values) != count:
                raise ValueError(f"{name} has {len(values)} entries instead of {count}.")
        if not set(driven) <= set(range(joints)):
            raise ValueError("joint_ids names a joint that does not exist.")
        gains = zip(additions.joints, self.stiffness, self.damping, strict=True)
        passive = [name for i, (name, *pair) in enumerate(gains) if i in driven and None in pair]
        if passive:
            raise ValueError(
                f"there are no gains (null) for {', '.join(passive)}, write their stiffness and "
                "damping there."
            )
        return self


@dataclass
class Export:
    """An export that can be played."""

    settings: Settings
    model: mujoco.MjModel
    policy: Path


def open_export(path: Path) -> Export:
    """Open an export by its folder or the file of its policy."""
    folder = path if path.is_dir() else path.parent
    if not path.exists():
        raise MorlaxError(f"there is no export {path}: morlax export writes one.")
    file = folder / SETTINGS
    if not file.exists():
        raise MorlaxError(
            f"{folder} has no {SETTINGS}: morlax export writes one for policies whose actions are "
            "positions of joints, such as those of mjlab's velocity tasks."
        )
    try:
        settings = Settings.model_validate(yaml.safe_load(read(file).decode()))
    except ValidationError as error:
        raise MorlaxError(f"{file}: {explained(error, Settings)}") from None
    except (ValueError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(f"{file} is not valid YAML: {reason}.") from None
    additions = settings.morlax_torch
    if additions.model is None:
        raise MorlaxError(f"{file} names no model, since its scene cannot be written.")
    archive = folder / additions.model
    try:  # a zip of an XML file and the files that it names
        with zipfile.ZipFile(io.BytesIO(read(archive, "model"))) as files:
            contents = {name: files.read(name) for name in files.namelist()}
        (name,) = (name for name in contents if name.endswith(".xml"))
        text = contents.pop(name).decode()
        model = mujoco.MjSpec.from_string(text, assets=contents).compile()
    except (ValueError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(f"cannot load the model {archive}: {reason}.") from None
    return Export(settings, model, folder / additions.policy if path == folder else path)
