"""The entries of deploy.yaml that are used here; docs/export.md explains all of them."""

from typing import Any

from pydantic import BaseModel, Field, model_validator

Values = list[float]
Range = tuple[float, float]


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


class Own(BaseModel):
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
    morlax_torch: Own

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
        own, action = self.morlax_torch, self.action
        of_joints = {
            "stiffness": self.stiffness,
            "damping": self.damping,
            "default_joint_pos": self.default_joint_pos,
            "default_joint_vel": own.default_joint_vel,
        }
        of_actions = {"scale": action.scale, "offset": action.offset}
        of_actions |= {} if action.clip is None else {"clip": action.clip}
        of_terms = {"observation_noise": own.observation_noise}
        counts = len(own.joints), len(self.driven), len(self.observations)
        for count, lists in zip(counts, (of_joints, of_actions, of_terms), strict=True):
            for name, values in lists.items():
                if len(values) != count:
                    raise ValueError(f"{name} has {len(values)} entries instead of {count}.")
        if not set(self.driven) <= set(range(len(own.joints))):
            raise ValueError("joint_ids names a joint that does not exist.")
        without = [
            own.joints[i] for i in self.driven if None in (self.stiffness[i], self.damping[i])
        ]
        if without:
            raise ValueError(
                f"there are no gains (null) for {', '.join(without)}, write their stiffness and "
                "damping there."
            )
        return self
