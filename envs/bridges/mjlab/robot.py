"""One robot of a task of mjlab, to look at, and the deploy.yaml that drives it outside."""

import io
import xml.etree.ElementTree as ET
import zipfile
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from ...worlds.interface import TimeStep
from ...worlds.mujoco_robot import Deployment, Part, Robot
from .motion import KEYS, bounds
from .step import MOCAP
from .walking import torque_limits
from .worlds import MjlabWorlds

NAMES = {  # mjlab's functions and unitree_rl_lab's terms, where the two differ
    "generated_commands": "velocity_commands",
    "projected_gravity_from_sensor": "projected_gravity",
}
UNITS = {
    "base_lin_vel": "m/s, in the body",
    "base_ang_vel": "rad/s, in the body",
    "projected_gravity": "1, in the body",
    "velocity_commands": "m/s, m/s, rad/s",
    "motion_command": "rad, then rad/s: all joints of the motion",
    "motion_anchor_pos_b": "m, to the motion's anchor body, in the robot's",
    "motion_anchor_ori_b": "1: rows of two columns of the matrix that turns between these bodies",
    "joint_pos_rel": "rad, from default_joint_pos",
    "joint_vel_rel": "rad/s",
    "last_action": "the policy's last output",
}
AXES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
SERVO = mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE


@cache
def robot_of(task: type[MjlabWorlds]) -> type["MjlabRobot"]:
    """Return the class of one robot of a task."""
    return type("MjlabRobot", (MjlabRobot, task), {})


class MjlabRobot(MjlabWorlds, Robot):
    """Worlds of mjlab on the CPU whose command stays as it is until someone changes it.

    An episode is a whole motion, if one is followed, or all of them in turn. A robot stays as its
    episode ended until it is restarted, so that viewers show its fall, and goes on after a time
    limit, as in films.
    """

    restarts = False

    def step(self, action: Tensor) -> TimeStep:
        self._over[1] = False
        return super().step(action)

    def _open(self, seed: int) -> None:
        self.options = self.options.model_copy(update={"robust": False})  # the robot as it is built
        super()._open(seed)
        data, model = self.env.sim.data, self.env.sim.mj_model
        model.stat.extent = self.env.cfg.viewer.distance / 2  # cameras stand two extents away
        state = {name: getattr(data, name)[:] for name in ("qpos", "qvel", "ctrl", "act")}
        parts = {name: [getattr(data, name)[:]] for name in MOCAP} if model.nmocap else {}
        self.physics = SimpleNamespace(model=model, parts=parts, **state)
        self.motion: Any = None  # mjlab's term of the command, if a motion is followed
        self.command_limits, self._velocity = {}, ""  # name of the command of a velocity
        for name, term in self.env.cfg.commands.items():
            ranges = vars(term.ranges) if hasattr(term, "ranges") else {}
            limits = {key: value for key, value in ranges.items() if key != "heading"}
            command = self.env.command_manager.get_command(name)
            if hasattr(term, "motion_file"):
                self.motion = self.env.command_manager.get_term(name)
                self.episode_length = self.motion.motion.time_step_total - 1
                self.env.cfg.episode_length_s = (self.episode_length - 0.5) * self.env.step_dt
                self._starts = torch.tensor(bounds(term.motion_file)[:-1])
                self.motion.cfg.sampling_mode = "uniform"
                self.motion._uniform_sampling = self._draw_frames
            if len(limits) == command.shape[1] and not self._velocity:
                self.command_limits, self.command = limits, command
                self._velocity = name if tuple(limits) == AXES else ""

    def config(self, seed: int) -> Any:
        cfg = super().config(seed)
        for term in cfg.commands.values():
            term.resampling_time_range = (1e9, 1e9)
            if hasattr(term, "sampling_mode"):
                term.sampling_mode = "start"  # of the motion, in each episode
            for share in ("rel_standing_envs", "rel_heading_envs", "rel_world_envs"):
                if hasattr(term, share):
                    setattr(term, share, -1.0)  # below what is drawn, so that no world has it
        return cfg

    def layout(self) -> list[Part]:
        return [
            Part(name, number * self.sizes[name], UNITS.get(self._label(name), "as in mjlab"))
            for name, number in self.lengths.items()
            if number
        ]

    def targets(self) -> list[str]:
        return [name for term in self._actions() for name in term.target_names]

    def scales(self) -> tuple[list[float], list[float]] | None:
        terms, size = self._actions(), self.options.action_scale
        if not all(type(term).__name__ == "JointPositionAction" for term in terms):
            return None
        each = [torch.ones(term.action_dim, dtype=torch.float32) for term in terms]
        scale = [(one * term.scale).view(-1) for one, term in zip(each, terms, strict=True)]
        offset = [(one * term.offset).view(-1) for one, term in zip(each, terms, strict=True)]
        return (size * torch.cat(scale)).tolist(), torch.cat(offset).tolist()

    def ghost(self) -> Tensor | None:
        if (command := self.motion) is None:
            return None
        pose, motion = self.physics.qpos[0].clone(), command.motion
        frame = command.time_steps[0]
        if not self._over.any() and frame not in self._starts:
            frame = frame - 1  # the command is the next one
        indexing = command.robot.indexing
        root = motion.body_pos_w[frame, 0], motion.body_quat_w[frame, 0]
        pose[indexing.free_joint_q_adr] = torch.cat(root)
        pose[indexing.joint_q_adr] = motion.joint_pos[frame]
        return pose

    def _draw_frames(self, worlds: Tensor) -> None:
        """Stay where another motion begins; an episode begins with the first."""
        frames = self.motion.time_steps
        frames[worlds] *= torch.isin(frames[worlds], self._starts)

    def deployment(self) -> Deployment | None:
        scales = self.scales()
        if scales is None:
            return None
        env, terms, model = self.env, self._actions(), self.env.sim.mj_model
        name, motions = terms[0].cfg.entity_name, list[bytes]()
        robot = env.scene[name]
        ids = torch.cat([term.target_ids for term in terms]).tolist()
        joints = [f"{name}/{joint}" for joint in robot.joint_names]
        stiffness, damping = zip(*(gains(model, joint) for joint in joints), strict=True)
        torques = torque_limits(model)[[model.joint(joint).dofadr[0] for joint in joints]]
        commands: dict[str, Any] = {}
        if tuple(self.command_limits) == AXES:
            ranges = {axis: list(limits) for axis, limits in self.command_limits.items()}
            commands["base_velocity"] = {"ranges": ranges | {"heading": None}}
        parts = self.layout()
        observed = [self._observed(part.name) for part in parts]
        observations: dict[str, Any] = {}
        for part in parts:
            label = self._label(part.name)
            # a controller reads the first term by unitree_rl_lab's name, and refuses a second one
            key = f"{label}_{part.name}" if label in observations else label
            observations[key] = self._observation(part)
        settings = {
            "joint_ids_map": list(range(len(joints))),
            "step_dt": env.step_dt,
            "stiffness": list(stiffness),
            "damping": list(damping),
            "default_joint_pos": robot.data.default_joint_pos[0].tolist(),
            "commands": commands,
            "actions": {
                "JointPositionAction": {
                    "clip": _clip(terms),
                    "joint_names": [robot.joint_names[index] for index in ids],
                    "scale": scales[0],
                    "offset": scales[1],
                    "joint_ids": None if ids == list(range(len(joints))) else ids,
                }
            },
            "observations": observations,
            "morlax_torch": {
                "joints": joints,
                "joint_limits": [model.joint(joint).range.tolist() for joint in joints],
                "torque_limits": [None if np.isinf(most) else float(most) for most in torques],
                "default_joint_vel": robot.data.default_joint_vel[0].tolist(),
                "observation_names": [part.name for part in parts],
                "observation_units": [part.unit for part in parts],
                "observation_noise": [
                    max(abs(getattr(cfg.noise, bound, 0.0)) for bound in ("n_min", "n_max"))
                    for cfg in observed
                ],
            },
        }
        if self.motion is not None:
            fps = round(1 / env.step_dt, 6)
            cfg, motions = self.motion.cfg, _motions(self.motion, fps)
            settings["morlax_torch"] |= {
                "motion_fps": fps,
                "anchor_body": f"{name}/{cfg.anchor_body_name}",
                "key_bodies": [f"{name}/{body}" for body in cfg.body_names],
            }
        return Deployment(settings, _zipped(env), motions)

    def _actions(self) -> list[Any]:
        manager = self.env.action_manager
        terms = [manager.get_term(name) for name in manager.active_terms]
        return [term for term in terms if term.action_dim]

    def _observed(self, name: str) -> Any:
        return self.env.observation_manager.get_term_cfg(self.groups[0], name)

    def _label(self, name: str) -> str:
        """Return unitree_rl_lab's name of a term of the observation."""
        cfg = self._observed(name)
        function: str = cfg.func.__name__
        if function == "generated_commands":
            command = cfg.params["command_name"]
            if self.motion is self.env.command_manager.get_term(command):
                return "motion_command"
            return NAMES[function] if command == self._velocity else name
        return name if function == "builtin_sensor" else NAMES.get(function, function)

    def _observation(self, part: Part) -> dict[str, Any]:
        """Return the settings of a term of the observation in unitree_rl_lab's shape."""
        cfg, label = self._observed(part.name), self._label(part.name)
        history = max(1, cfg.history_length) * self.lengths[part.name]
        scale = torch.ones(part.size // history, dtype=torch.float32)
        scale *= 1.0 if cfg.scale is None else cfg.scale
        clip = cfg.clip and list(cfg.clip)
        if label == "last_action":  # mjlab sees actions that have been scaled
            scale *= self.options.action_scale
            clip = clip and [bound / self.options.action_scale for bound in clip]
        named = "sensor_name", "command_name"
        params = {name: value for name, value in cfg.params.items() if name in named}
        joints = getattr(cfg.params.get("asset_cfg"), "joint_ids", slice(None))
        if not isinstance(joints, slice):
            params["asset_cfg"] = {"joint_ids": joints}
        if label == "velocity_commands":
            params["command_name"] = "base_velocity"
        if label.startswith("motion_"):
            params["command_name"] = "motion"
        return {"params": params, "clip": clip, "scale": scale.tolist(), "history_length": history}


def gains(model: mujoco.MjModel, joint: str) -> tuple[float, float] | tuple[None, None]:
    """Return stiffness (N m/rad) and damping (N m s/rad) of a joint's position servo, if any."""
    of_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    driven = model.actuator_trnid[:, 0] == model.joint(joint).id
    indices = (of_joint & driven).nonzero()[0]
    if len(indices) != 1:
        return None, None
    servo = model.actuator(indices[0])
    kinds = servo.dyntype[0], servo.gaintype[0], servo.biastype[0]
    gain, (offset, stiffness, damping) = servo.gainprm[0], -servo.biasprm[:3]
    if kinds == SERVO and servo.gear[0] == 1 and offset == 0 and gain == stiffness > 0:
        return float(stiffness), float(damping)
    return None, None


def _clip(terms: list[Any]) -> list[list[float]] | None:
    """Return the limits of each target, after scale and offset; None if no target is limited."""
    if all(term.cfg.clip is None for term in terms):
        return None
    rows: list[list[float]] = []
    for term in terms:
        free = [[-float("inf"), float("inf")]] * term.action_dim
        rows += free if term.cfg.clip is None else term._clip[0].tolist()
    return rows


def _motions(command: Any, fps: float) -> list[bytes]:
    """Return the motions of mjlab's command as files with mjlab's names, of key bodies only."""
    arrays, contents = {name: getattr(command.motion, name).numpy() for name in KEYS}, []
    for first, end in pairwise(bounds(command.cfg.motion_file)):
        file = io.BytesIO()
        part = {name: values[first:end] for name, values in arrays.items()}
        np.savez_compressed(file, fps=np.array([fps]), **part)
        contents.append(file.getvalue())
    return contents


def _zipped(env: Any) -> bytes | None:
    """Return a zip of the scene's XML and files; None if MuJoCo cannot write it as XML."""
    spec = env.scene.spec.copy()
    if getattr(env.scene.terrain, "terrain_origins", None) is not None:
        _flatten(spec)
    env.cfg.sim.mujoco.apply(SimpleNamespace(opt=spec.option))
    try:
        text = import_module("mjlab.utils.xml").fix_spec_xml(spec.to_xml(), meshdir="")
    except (ValueError, mujoco.FatalError):
        return None
    paths = {node.get("file", "") for node in ET.fromstring(text).iter()} - {""}
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("robot.xml", text)
        for path in sorted(paths):
            archive.writestr(path, _read(env, path))
    return file.getvalue()


def _flatten(spec: mujoco.MjSpec) -> None:
    """Replace mjlab's uneven ground by a plane, because XML does not hold its textures."""
    ground = spec.body("terrain")
    pictures = [thing for thing in (*spec.materials, *spec.textures) if thing.name[:3] == "hf_"]
    for thing in (*ground.geoms, *spec.hfields, *pictures):
        spec.delete(thing)
    ground.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.01], material="groundplane")


def _read(env: Any, path: str) -> bytes:
    """Read a file that the scene names; an attached robot's are relative to its own folder."""
    for entity in env.scene.entities.values():
        spec = entity.spec
        for key, content in spec.assets.items():
            if key == path or key.endswith(f"/{path}"):
                return content
        for folder in (spec.meshdir, spec.texturedir):
            file = Path(spec.modelfiledir, folder, path)
            if file.is_file():
                return file.read_bytes()
    raise FileNotFoundError(path)
