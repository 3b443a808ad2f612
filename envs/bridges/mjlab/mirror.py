"""The mirror of a robot of mjlab: joints as in its model, other observations term by term."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ...errors import MorlaxError
from ...worlds.mirror import FLIP, PARALLEL, Mirror, Reflection, check, partners, posed
from .commands import VELOCITY

POLAR = (mujoco.mjtSensor.mjSENS_VELOCIMETER, mujoco.mjtSensor.mjSENS_ACCELEROMETER)


def mirror_of(
    env: Any, groups: Sequence[str], tolerance: float = 0.0, lengths: dict[str, int] | None = None
) -> Mirror:
    """Return the mirror of mjlab's worlds that see `groups`; for the tolerance, see `check`.

    Of the first group, `lengths` values of each term are seen, by default one.
    """
    terms, manager, parts = _Terms(env, tolerance), env.observation_manager, []
    for group in groups:
        for term in manager.active_terms[group]:
            number = lengths[term] if lengths and group == groups[0] else 1
            if not number:
                continue
            cfg = manager.get_term_cfg(group, term)
            reflect = getattr(terms, cfg.func.__name__, None)
            reflection = reflect(cfg.params) if reflect else None
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
            parts += [reflection] * max(length, 1) * number  # flat, from oldest to newest
    return Mirror(Reflection.joined(parts), terms.last_action({}))


class _Terms:
    """The reflection of each of mjlab's terms of observations, by its name and parameters."""

    def __init__(self, env: Any, tolerance: float):
        self._env, self._model = env, env.sim.mj_model
        self._motion = check(self._model, tolerance, scene=False)
        self._data = posed(self._model)
        entities = env.scene.entities.items()
        self._name, self._robot = next((n, entity) for n, entity in entities if entity.num_joints)

    def projected_gravity(self, params: dict[str, Any]) -> Reflection:
        return _vector(FLIP)

    base_lin_vel = projected_gravity

    def base_ang_vel(self, params: dict[str, Any]) -> Reflection:
        return _vector(-FLIP)

    def joint_pos_rel(self, params: dict[str, Any]) -> Reflection:
        names = np.array(self._robot.joint_names)
        chosen = params["asset_cfg"].joint_ids if "asset_cfg" in params else slice(None)
        return self._joints(names[chosen].tolist())

    joint_vel_rel = joint_pos_rel

    def last_action(self, params: dict[str, Any]) -> Reflection:
        manager = self._env.action_manager
        terms = [manager.get_term(name) for name in manager.active_terms]
        return self._joints([name for term in terms for name in term.target_names])

    def generated_commands(self, params: dict[str, Any]) -> Reflection | None:
        term = self._env.command_manager.get_term(params["command_name"])
        return _vector([1.0, -1.0, -1.0]) if type(term).__name__ == VELOCITY else None

    def builtin_sensor(self, params: dict[str, Any]) -> Reflection | None:
        sensor = self._model.sensor(params["sensor_name"])
        frame = self._data.site_xmat[sensor.objid[0]].reshape(3, 3)
        reflected = frame.T @ np.diag(FLIP) @ frame
        signs = np.round(np.diag(reflected))
        if abs(reflected - np.diag(signs)).max() > 1 - PARALLEL:
            return None
        if sensor.type[0] == mujoco.mjtSensor.mjSENS_GYRO:
            return _vector(-signs)
        return _vector(signs) if sensor.type[0] in POLAR else None

    def height_scan(self, params: dict[str, Any]) -> Reflection | None:
        """Reflect the rays of a grid below the robot."""
        sensor = self._env.scene[params["sensor_name"]]
        if sensor.num_frames > 1:
            return None
        rays = sensor._local_offsets.cpu().numpy()
        names = [f"ray {number} of {params['sensor_name']}" for number in range(len(rays))]
        return Reflection.of(partners(rays, names), [1.0] * len(rays))

    def foot_height(self, params: dict[str, Any]) -> Reflection:
        frames = self._env.scene[params["sensor_name"]].cfg.frame
        return self._feet([(frame.type, f"{frame.entity}/{frame.name}") for frame in frames])

    def foot_contact(self, params: dict[str, Any]) -> Reflection:
        sensor = self._env.scene[params["sensor_name"]]
        match = sensor.cfg.primary
        kind = "geom" if match.mode == "geom" else "body"
        names = [name.removeprefix(f"{match.entity}/") for name in sensor.primary_names]
        return self._feet([(kind, f"{match.entity}/{name}") for name in names])

    foot_air_time = foot_contact

    def foot_contact_forces(self, params: dict[str, Any]) -> Reflection:
        """Reflect a force in the frame of the world for each foot."""
        feet = self.foot_contact(params).order.tolist()
        return Reflection.of([3 * k + axis for k in feet for axis in range(3)], [*FLIP] * len(feet))

    def _joints(self, names: Sequence[str]) -> Reflection:
        joints = [self._model.joint(f"{self._name}/{name}").id for name in names]
        dofs, velocities = self._model.jnt_dofadr[joints].tolist(), self._motion.velocities
        images = velocities.order[dofs].tolist()
        for name in (name for name, dof in zip(names, images, strict=True) if dof not in dofs):
            raise MorlaxError(f"{name} is used without its mirrored partner on the robot.")
        return Reflection.of([dofs.index(dof) for dof in images], velocities.sign[dofs].tolist())

    def _feet(self, things: Sequence[tuple[str, str]]) -> Reflection:
        """Return the reflection of one number of each body, geom or site, given as (type, name)."""
        positions = np.array([getattr(self._data, kind)(name).xpos for kind, name in things])
        names = [name for _, name in things]
        return Reflection.of(partners(positions, names), [1.0] * len(names))


def _vector(signs: Sequence[float] | np.ndarray) -> Reflection:
    return Reflection.of(range(3), list(signs))
