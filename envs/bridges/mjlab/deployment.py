"""What drives a robot of mjlab outside, in the shape of unitree_rl_lab's deploy.yaml."""

import io
import xml.etree.ElementTree as ET
import zipfile
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import torch

from ...worlds.mujoco_robot import Deployment

XML = "robot.xml"
NAMES = {  # mjlab's functions and unitree_rl_lab's terms, where the two differ
    "generated_commands": "velocity_commands",
    "projected_gravity_from_sensor": "projected_gravity",
}
UNITS = {
    "base_lin_vel": "m/s, in the body",
    "base_ang_vel": "rad/s, in the body",
    "projected_gravity": "1, in the body",
    "velocity_commands": "m/s, m/s, rad/s",
    "joint_pos_rel": "rad, from default_joint_pos",
    "joint_vel_rel": "rad/s",
    "last_action": "the policy's last output",
}
AXES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


def deployment_of(
    env: Any,
    group: str,
    mapping: dict[str, list[float]],
    action_scale: float,
    limits: dict[str, tuple[float, float]],
) -> Deployment:
    """Return the deployment of mjlab's environment, whose actions are positions of joints.

    Args:
        env: mjlab's environment.
        group: of observations that the policy sees.
        mapping: scale and offset of each action.
        action_scale: factor on the policy's output before mjlab sees it.
        limits: range of each number of the command.
    """
    terms = [env.action_manager.get_term(name) for name in env.action_manager.active_terms]
    robot, name = env.scene[terms[0].cfg.entity_name], terms[0].cfg.entity_name
    ids = torch.cat([term.target_ids for term in terms]).tolist()
    joints = [f"{name}/{joint}" for joint in robot.joint_names]
    model = env.sim.mj_model
    rows = [motor(model, joint) for joint in joints]
    observations = _observations(env, group, action_scale)
    settings = {
        "joint_ids_map": list(range(len(joints))),
        "step_dt": env.step_dt,
        "stiffness": [row["stiffness"] for row in rows],
        "damping": [row["damping"] for row in rows],
        "default_joint_pos": robot.data.default_joint_pos[0].tolist(),
        "commands": _commands(limits),
        "actions": {
            "JointPositionAction": {
                "clip": _clip(terms),
                "joint_names": [robot.joint_names[index] for index in ids],
                **mapping,
                "joint_ids": None if ids == list(range(len(joints))) else ids,
            }
        },
        "observations": {term.pop("name"): term for term, _ in observations},
        "morlax_torch": {
            "joints": joints,
            "joint_limits": [model.joint(joint).range.tolist() for joint in joints],
            "torque_limits": [row["torque"] for row in rows],
            "default_joint_vel": robot.data.default_joint_vel[0].tolist(),
            "observation_names": [about["name"] for _, about in observations],
            "observation_units": [about["unit"] for _, about in observations],
            "observation_noise": [about["noise"] for _, about in observations],
        },
    }
    return Deployment(settings, _zipped(env))


def motor(model: mujoco.MjModel, joint: str) -> dict[str, float | None]:
    """Return the gains (N m/rad, N m s/rad) and the largest torque of a joint's motor.

    Gains are None unless one actuator of the model drives the joint to a position. The torque is
    None if nothing limits it.
    """
    of_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    driven = model.actuator_trnid[:, 0] == model.joint(joint).id
    found = (of_joint & driven).nonzero()[0]
    nothing: dict[str, float | None] = {"stiffness": None, "damping": None, "torque": None}
    if len(found) != 1:
        return nothing
    (index,) = found
    limited, most = model.actuator_forcelimited[index], model.actuator_forcerange[index, 1]
    torque = float(most) if limited else None
    gain, bias = model.actuator_gainprm[index], model.actuator_biasprm[index]
    is_position = (
        model.actuator_dyntype[index] == mujoco.mjtDyn.mjDYN_NONE
        and model.actuator_gaintype[index] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
        and model.actuator_gear[index, 0] == 1
        and gain[0] > 0
        and bias[0] == 0
        and bias[1] == -gain[0]
    )
    if not is_position:
        return {**nothing, "torque": torque}
    return {"stiffness": float(gain[0]), "damping": float(-bias[2]), "torque": torque}


def _observations(
    env: Any, group: str, action_scale: float
) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return each term in unitree_rl_lab's shape, and what else is known about it."""
    manager = env.observation_manager
    found = []
    name: str
    for name, size in zip(
        manager.active_terms[group], manager.group_obs_term_dim[group], strict=True
    ):
        cfg = manager.get_term_cfg(group, name)
        history = max(1, cfg.history_length)
        width = torch.Size(size).numel() // history
        function: str = cfg.func.__name__
        theirs = name if function == "builtin_sensor" else NAMES.get(function, function)
        scale = torch.ones(width, dtype=torch.float32) * (1.0 if cfg.scale is None else cfg.scale)
        clip = None if cfg.clip is None else list(cfg.clip)
        if theirs == "last_action":  # mjlab sees actions that have been scaled
            scale = scale * action_scale
            clip = clip and [bound / action_scale for bound in clip]
        params = {"command_name": "base_velocity"} if theirs == "velocity_commands" else {}
        if "sensor_name" in cfg.params:
            params["sensor_name"] = cfg.params["sensor_name"]
        term = {"name": theirs, "params": params, "clip": clip, "scale": scale.tolist()}
        bounds = [abs(getattr(cfg.noise, bound, 0.0)) for bound in ("n_min", "n_max")]
        about = {"name": name, "unit": UNITS.get(theirs, "as in mjlab"), "noise": max(bounds)}
        found.append(({**term, "history_length": history}, about))
    return found


def _commands(limits: dict[str, tuple[float, float]]) -> dict[str, Any]:
    if tuple(limits) != AXES:
        return {}
    ranges = {axis: list(limits[axis]) for axis in AXES} | {"heading": None}
    return {"base_velocity": {"ranges": ranges}}


def _clip(terms: list[Any]) -> list[list[float]] | None:
    """Return the limits of each target, after scale and offset; None if no target is limited."""
    if all(term.cfg.clip is None for term in terms):
        return None
    free = [-float("inf"), float("inf")]
    return [
        row
        for term in terms
        for row in ([free] * term.action_dim if term.cfg.clip is None else term._clip[0].tolist())
    ]


def _zipped(env: Any) -> bytes | None:
    """Return a zip of the scene's XML, with the options of the simulation, and of its files.

    None if MuJoCo cannot write the scene as XML, such as generated terrain.
    """
    fixing = import_module("mjlab.utils.xml")
    spec = env.scene.spec.copy()
    env.cfg.sim.mujoco.apply(SimpleNamespace(opt=spec.option))
    try:
        text = fixing.fix_spec_xml(spec.to_xml(), meshdir="")
    except (ValueError, mujoco.FatalError):
        return None
    named = {node.get("file", "") for node in ET.fromstring(text).iter()} - {""}
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(XML, text)
        for path in sorted(named):
            archive.writestr(path, _read(env, path))
    return file.getvalue()


def _read(env: Any, path: str) -> bytes:
    """Read a file that the scene names; an attached robot's are relative to its own folder."""
    for entity in env.scene.entities.values():
        spec = entity.spec
        for key, content in spec.assets.items():
            if key == path or key.endswith(f"/{path}"):
                return content
        for folder in (spec.meshdir, spec.texturedir):
            place = Path(spec.modelfiledir, folder, path)
            if place.is_file():
                return place.read_bytes()
    raise FileNotFoundError(path)
