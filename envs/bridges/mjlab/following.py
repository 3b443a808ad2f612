"""How robots of mjlab's tracking tasks follow a motion: rewards and quantities that mjlab lacks."""

from importlib import import_module
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .motion import bounds
from .step import Constants
from .walking import Measures

QUANTITIES = (
    "body error (mm)",  # of the key bodies, relative to the root; mjlab's r_mpkpe
    "global body error (mm)",  # in the world; mjlab's mpkpe
    "end-effector error (mm)",  # of hands and feet, relative to the root
    "joint velocity error (rad/s)",  # root mean square over the joints
    "power (W)",  # positive mechanical power, summed over the joints
    "impact (share of the weight)",  # root mean square of `landing_impact`
    "hottest joint (share of its torque limit)",  # root mean square of its torque over time
    "acceleration of the base (m/s²)",  # root mean square
    "falls (per 1,000 steps)",
)
SENSOR = "end_effector_contact"
COLUMNS = 7  # of `Following.measure`, before those of joints
GOLDEN = (5**0.5 - 1) / 2  # its multiples, modulo 1, are spread evenly


def add_terms(cfg: Any) -> None:
    """Offer a tracking task rewards of its end effectors, whose names a termination of it has."""
    name = next((key for key, term in cfg.commands.items() if hasattr(term, "motion_file")), None)
    if name is None or not (ends := end_effectors(cfg)):
        return
    managers, sensors = import_module("mjlab.managers"), import_module("mjlab.sensor")
    rewards = import_module("mjlab.tasks.tracking.mdp.rewards")
    match, entity = sensors.ContactMatch, cfg.commands[name].entity_name
    contact = sensors.ContactSensorCfg(
        name=SENSOR,
        primary=match(mode="subtree", pattern=ends, entity=entity),
        secondary=match(mode="body", pattern="terrain"),
        fields=("force",),
        reduce="netforce",
        history_length=cfg.decimation + 1,
    )
    cfg.scene.sensors = (*cfg.scene.sensors, contact)
    position = rewards.motion_relative_body_position_error_exp
    orientation = rewards.motion_relative_body_orientation_error_exp
    of_ends = {"command_name": name, "body_names": ends}
    for term, function, params in (
        ("end_effector_pos", position, {**of_ends, "std": 0.15}),
        ("end_effector_ori", orientation, {**of_ends, "std": 0.4}),
        ("landing_impact", landing_impact, {}),
    ):
        cfg.rewards[term] = managers.RewardTermCfg(func=function, weight=0.0, params=params)


def end_effectors(cfg: Any) -> tuple[str, ...]:
    term = cfg.terminations.get("ee_body_pos")
    return tuple(term.params["body_names"]) if term else ()


def landing_impact(env: Any) -> Tensor:
    """Return (N,): how much load hands and feet took in this control step, in weights, squared."""
    forces = env.scene[SENSOR].data.force_history.norm(dim=-1)  # (N, ends, newest first)
    model = env.sim.mj_model
    weight = float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))
    rise = (forces[..., :-1].amax(-1) - forces[..., -1]).clamp(min=0) / weight
    began = env.episode_length_buf <= 1  # the sensor did not see what the robot stood on
    return rise.square().sum(1) * ~began


class Following(Measures):
    """Measures robots that follow a motion."""

    def __init__(self, env: Any, command: Any):
        super().__init__(env, command)
        self._metrics = import_module("mjlab.tasks.tracking.mdp.metrics")
        self._constants = Constants()  # names of end effectors become indices
        self.look()

    def look(self) -> None:
        """Keep the frame of the motion that the next step is measured against, as mjlab does."""
        names = "body_pos_w", "body_pos_relative_w", "joint_vel"
        values = {name: getattr(self._command, name).clone() for name in names}
        self._frame = SimpleNamespace(cfg=self._command.cfg, **values)

    def start(self, episodes: Tensor, length: int) -> None:
        """Start each of `episodes` (N,) at its frame, so early that it ends before its motion."""
        command = self._command
        motions = pairwise(bounds(command.cfg.motion_file))
        frames = torch.cat([torch.arange(first, end - length) for first, end in motions])
        starts = frames[(episodes * GOLDEN % 1 * len(frames)).long()].to(command.device)
        command.cfg.sampling_mode = "uniform"
        command._uniform_sampling = lambda ids: command.time_steps.index_copy_(0, ids, starts[ids])

    def measure(self) -> Tensor:
        """Return numbers of this step, (N, COLUMNS + joints), to take means of."""
        data, frame, metrics = self._robot.data, self._frame, self._metrics
        frame.robot_body_pos_w = self._command.robot_body_pos_w
        frame.robot_joint_vel = self._command.robot_joint_vel
        torque = data.qfrc_actuator
        with self._constants:
            of_ends = metrics.compute_ee_position_error(frame, end_effectors(self._env.cfg))
        numbers = (
            metrics.compute_root_relative_mpkpe(frame),
            metrics.compute_mpkpe(frame),
            of_ends,
            metrics.compute_joint_velocity_error(frame),
            (torque * data.joint_vel).clamp(min=0).sum(1),
            landing_impact(self._env),
            data.data.qacc[:, self._base].square().sum(1),
        )
        return torch.cat([torch.stack(numbers, 1), (torque / self._limits).square()], 1)

    def quantify(self, means: np.ndarray, falls: np.ndarray) -> np.ndarray:
        """Return QUANTITIES (K, 9) from means over time (K, COLUMNS + joints) and falls (K,)."""
        errors, (velocity, power) = 1000 * means[:, :3].T, means[:, 3:5].T
        impact, jolts = means[:, 5:7].T ** 0.5
        hottest = means[:, COLUMNS:].max(1) ** 0.5
        return np.stack([*errors, velocity, power, impact, hottest, jolts, 1000 * falls], 1)
