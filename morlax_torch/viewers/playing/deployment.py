"""Open an export: deploy.yaml, the model of the robot, and the policy's file."""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import yaml
from pydantic import AliasPath, BaseModel, Field, ValidationError, model_validator

from ...envs import MorlaxError
from ...envs.errors import explained
from ...exports.deployment import SETTINGS
from ...host.files import read

Values = list[float]
Range = tuple[float, float]


class Term(BaseModel):
    """A term of the observation."""

    params: dict[str, Any]
    clip: Range | None
    scale: Values
    history_length: int = Field(ge=1)


def _in(*path: str, **constraints: Any) -> Any:
    """Return a field that lies deeper in deploy.yaml."""
    return Field(validation_alias=AliasPath(*path), **constraints)


RANGES = "commands", "base_velocity", "ranges"
ACTION = "actions", "JointPositionAction"
OURS = "morlax_torch"  # the entries that unitree_rl_lab does not have


class Settings(BaseModel):
    """The entries of deploy.yaml that are used here; docs/export.md explains all of them."""

    step_dt: float = Field(gt=0)
    stiffness: list[float | None]
    damping: list[float | None]
    default_joint_pos: Values
    observations: dict[str, Term]
    lin_vel_x: Range = _in(*RANGES, "lin_vel_x")
    lin_vel_y: Range = _in(*RANGES, "lin_vel_y")
    ang_vel_z: Range = _in(*RANGES, "ang_vel_z")
    clip: list[Range] | None = _in(*ACTION, "clip")
    scale: Values = _in(*ACTION, "scale")
    offset: Values = _in(*ACTION, "offset")
    joint_ids: list[int] | None = _in(*ACTION, "joint_ids")
    policy: str = _in(OURS, "policy")
    model: str | None = _in(OURS, "model")
    objectives: list[str] = _in(OURS, "objectives")
    slew: float | None = _in(OURS, "slew", gt=0)
    joints: list[str] = _in(OURS, "joints")
    default_joint_vel: Values = _in(OURS, "default_joint_vel")
    observation_noise: Values = _in(OURS, "observation_noise")

    @property
    def driven(self) -> list[int]:
        """The joint of each action."""
        return list(range(len(self.joints))) if self.joint_ids is None else self.joint_ids

    @property
    def limits(self) -> list[Range]:
        """The range of each number of the command: m/s, m/s, rad/s."""
        return [self.lin_vel_x, self.lin_vel_y, self.ang_vel_z]

    @model_validator(mode="after")
    def _check(self) -> "Settings":
        driven, joints = self.driven, len(self.joints)
        counts = dict.fromkeys(("scale", "offset", "clip"), len(driven))
        names = ("stiffness", "damping", "default_joint_pos", "default_joint_vel")
        counts |= dict.fromkeys(names, joints) | {"observation_noise": len(self.observations)}
        for name, count in counts.items():
            values = getattr(self, name)
            if values is not None and len(values) != count:
                raise ValueError(f"{name} has {len(values)} entries instead of {count}.")
        if not set(driven) <= set(range(joints)):
            raise ValueError("joint_ids names a joint that does not exist.")
        gains = zip(self.joints, self.stiffness, self.damping, strict=True)
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
    if settings.model is None:
        raise MorlaxError(f"{file} names no model, since its scene cannot be written.")
    archive = folder / settings.model
    try:  # a zip of an XML file and the files that it names
        with zipfile.ZipFile(io.BytesIO(read(archive, "model"))) as files:
            contents = {name: files.read(name) for name in files.namelist()}
        (name,) = (name for name in contents if name.endswith(".xml"))
        text = contents.pop(name).decode()
        model = mujoco.MjSpec.from_string(text, assets=contents).compile()
    except (ValueError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(f"cannot load the model {archive}: {reason}.") from None
    return Export(settings, model, folder / settings.policy if path == folder else path)
