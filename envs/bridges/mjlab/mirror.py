"""The mirror of a robot of mjlab, found in its model.

Joints and feet are partners if they lie at mirrored places in the model's zero pose.
"""

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np

from ...errors import MorlaxError
from ...worlds import sides
from ...worlds.mirror import (
    FLIP,
    PARALLEL,
    Mirror,
    Reflection,
    of_joints,
    partners,
)

POLAR = (mujoco.mjtSensor.mjSENS_VELOCIMETER, mujoco.mjtSensor.mjSENS_ACCELEROMETER)


def mirror_of(env: Any, groups: Sequence[str], tolerance: float = 0.0) -> Mirror:
    """Return the mirror of an environment of mjlab whose policies and critics see `groups`.

    Numbers of left and right may differ by the tolerance, see `sides.check`.

    Raises:
        MorlaxError: the robot's left and right differ, or a term of the observation or action has
            no known reflection.
    """
    robot, manager = _Robot(env), env.observation_manager
    parts = []
    for group in groups:
        for term in manager.active_terms[group]:
            cfg = manager.get_term_cfg(group, term)
            find = robot.terms.get(cfg.func.__name__)
            reflection = find(cfg.params) if find else None
            length = cfg.history_length
            if reflection is None or (length and not cfg.flatten_history_dim):
                raise MorlaxError(
                    f"the mirror image of the observation {term} is not known: set "
                    "network.symmetric to false."
                )
            scale = np.ravel(1.0 if cfg.scale is None else cfg.scale.cpu())
            turned = bool((reflection.sign < 0).any() and cfg.clip and sum(cfg.clip))
            if turned or (len(scale) > 1 and (scale != scale[reflection.order]).any()):
                raise MorlaxError(
                    f"left and right differ in clip or scale of the observation {term}: set "
                    "network.symmetric to false."
                )
            parts += [reflection] * max(length, 1)  # a history is flat, from oldest to newest
    mirror = Mirror(Reflection.joined(parts), robot.actions({}))
    sides.check(robot.model, sides.motion_of(robot.model), tolerance, scene=False)
    return mirror


class _Robot:
    """The robot of an environment in its zero pose."""

    def __init__(self, env: Any):
        self.env, self.model = env, env.sim.mj_model
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.name, self.entity = next(
            (name, entity) for name, entity in env.scene.entities.items() if entity.num_joints
        )
        self.root = self.model.body(f"{self.name}/{self.entity.body_names[0]}").id
        self.frame = self.data.xmat[self.root].reshape(3, 3)
        self.terms: dict[str, Callable[[dict[str, Any]], Reflection | None]] = {
            "builtin_sensor": self.sensor,
            "projected_gravity": lambda _: _vector(FLIP),
            "base_lin_vel": lambda _: _vector(FLIP),
            "base_ang_vel": lambda _: _vector(-FLIP),
            "joint_pos_rel": self.joints,
            "joint_vel_rel": self.joints,
            "last_action": self.actions,
            "generated_commands": self.command,
            "foot_height": lambda params: Reflection.of(*self.heights(params)),
            "foot_air_time": lambda params: Reflection.of(*self.contacts(params)),
            "foot_contact": lambda params: Reflection.of(*self.contacts(params)),
            "foot_contact_forces": self.forces,
        }

    def at(self, position: np.ndarray) -> np.ndarray:
        """Return a position in the robot's own frame."""
        return (position - self.data.xpos[self.root]) @ self.frame

    def of_joints(self, names: Sequence[str]) -> Reflection:
        joints = [self.model.joint(f"{self.name}/{name}").id for name in names]
        places = np.array([self.at(self.data.xanchor[joint]) for joint in joints])
        axes = np.array([self.data.xaxis[joint] @ self.frame for joint in joints])
        slides = self.model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
        return of_joints(places, axes, slides, names)

    def joints(self, params: dict[str, Any]) -> Reflection:
        names = np.array(self.entity.joint_names)
        chosen = params["asset_cfg"].joint_ids if "asset_cfg" in params else slice(None)
        return self.of_joints(names[chosen].tolist())

    def actions(self, params: dict[str, Any]) -> Reflection:
        manager = self.env.action_manager
        terms = [manager.get_term(name) for name in manager.active_terms]
        return self.of_joints([name for term in terms for name in term.target_names])

    def command(self, params: dict[str, Any]) -> Reflection | None:
        term = self.env.command_manager.get_term(params["command_name"])
        known = type(term).__name__ == "UniformVelocityCommand"
        return _vector([1.0, -1.0, -1.0]) if known else None

    def sensor(self, params: dict[str, Any]) -> Reflection | None:
        sensor = self.model.sensor(params["sensor_name"])
        frame = self.data.site_xmat[sensor.objid[0]].reshape(3, 3)
        reflected = frame.T @ self.frame @ np.diag(FLIP) @ self.frame.T @ frame
        signs = np.round(np.diag(reflected))
        if abs(reflected - np.diag(signs)).max() > 1 - PARALLEL:
            return None
        if sensor.type[0] == mujoco.mjtSensor.mjSENS_GYRO:
            return _vector(-signs)
        return _vector(signs) if sensor.type[0] in POLAR else None

    def heights(self, params: dict[str, Any]) -> tuple[list[int], list[float]]:
        frames = self.env.scene[params["sensor_name"]].cfg.frame
        places = [(frame.type, f"{frame.entity}/{frame.name}") for frame in frames]
        return self.pairs(places)

    def contacts(self, params: dict[str, Any]) -> tuple[list[int], list[float]]:
        sensor = self.env.scene[params["sensor_name"]]
        match = sensor.cfg.primary
        kind = "geom" if match.mode == "geom" else "body"
        names = [name.removeprefix(f"{match.entity}/") for name in sensor.primary_names]
        return self.pairs([(kind, f"{match.entity}/{name}") for name in names])

    def pairs(self, places: Sequence[tuple[str, str]]) -> tuple[list[int], list[float]]:
        """Return the partners of bodies, geoms or sites, given as (type, name)."""
        found = [self.at(getattr(self.data, kind)(name).xpos) for kind, name in places]
        names = [name for _, name in places]
        return partners(np.array(found), names), [1.0] * len(places)

    def forces(self, params: dict[str, Any]) -> Reflection:
        """Reflect a force in the frame of the world for each foot."""
        order, _ = self.contacts(params)
        each = [3 * k + axis for k in order for axis in range(3)]
        return Reflection.of(each, FLIP.tolist() * len(order))


def _vector(signs: Sequence[float] | np.ndarray) -> Reflection:
    return Reflection.of(range(3), list(signs))
