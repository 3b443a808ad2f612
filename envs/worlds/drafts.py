"""First drafts of task files, from nothing but an MJCF. Imports no torch."""

import re
from pathlib import Path
from textwrap import shorten

import jinja2
import mujoco
import numpy as np
from mujoco import mjtBias, mjtDyn, mjtJoint, mjtTrn

from ..errors import MorlaxError, user_code, warn_user
from .trees import base_of, horizontal

TEMPLATE = Path(__file__).with_name("draft.jinja").read_text()
WORDS = {*re.findall(r"\w+", TEMPLATE)}  # names that the written class would hide
STRIDE = 0.5  # rad or m, by which servos of a robot that can fall leave the start pose at most
TRIAL, HOLD = 100, 10  # control steps of random actions from one start, and of each action


class Draft:
    """A task for the robot of an MJCF, whose attributes fill in draft.jinja."""

    def __init__(self, path: Path):
        with user_code(f"MuJoCo cannot load {path}"):
            self.model = model = mujoco.MjSpec.from_file(str(path)).compile()
        if not model.nu:
            motor = '<actuator><motor joint="hip" ctrlrange="-20 20"/></actuator>'
            urdf = path.suffix.lower() == ".urdf"
            first = "save it as an MJCF, mujoco.MjSpec.from_file(...).to_file(...), and " * urdf
            raise MorlaxError(
                f"{path} has no actuators: {first}add them for its joints, such as {motor}."
            )
        if model.nu != len(model.actuator_trntype):
            raise MorlaxError(
                f"{path} has actuators with several controls, such as <orientation>: write its "
                "task yourself (docs/your-own-robot.md), or give each actuator one control."
            )
        keys = [model.key(number).name for number in range(model.nkey)]
        self.key = next((key for key in ("home", "stand", *keys) if key and key in keys), None)
        self.data = mujoco.MjData(model)
        self._restart()
        base, geoms = base_of(model), model.geom_contype | model.geom_conaffinity
        along = horizontal(model, base)  # degrees of freedom that move the base along the floor
        joints, still = model.dof_jntid[along], model.body_weldid[model.geom_bodyid] == 0
        free = mjtJoint.mjJNT_FREE in model.jnt_type[joints]
        if free and not geoms[still].any():
            floor = '<geom type="plane" size="0 0 1"/>'
            raise MorlaxError(f"{path} has no floor: name a scene that has one, or add {floor}.")
        motors = model.actuator_trntype == mjtTrn.mjTRN_JOINT
        driven = np.isin(joints, model.actuator_trnid[motors, 0]).any()
        self.floating = free or (bool(along) and not driven)
        first = self.floating and along == list(range(len(along)))
        self.unobserved = len(along) if first else 0  # leading numbers of qpos
        robot = np.flatnonzero(model.body_treeid == model.body_treeid[base])
        tips = robot[~np.isin(robot, model.body_parentid)]
        far = np.linalg.norm(self.data.xipos[tips] - self.data.xpos[base], axis=1)
        self.body = base if self.floating else tips[far.argmax()]
        if not model.body(self.body).name:
            name = '<body name="trunk">'
            raise MorlaxError(f"body {self.body} of {path} is rewarded: name it, such as {name}.")
        self.height, self.upright = self.data.xpos[base, 2], self.data.xmat[base, 8] > 0.9
        self.sensors = shorten(", ".join(model.sensor(i).name for i in range(model.nsensor)), 60)
        self._see_actuators()
        self._act_at_random()

    def text(self, name: str, model_file: str) -> str:
        """Return the text of a Python file that defines the class `name`."""
        made = jinja2.Template(TEMPLATE, trim_blocks=True, lstrip_blocks=True)
        made.environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
        return made.render(vars(self), name=name, model_file=model_file)

    def _restart(self) -> None:
        key = -1 if self.key is None else self.model.key(self.key).id
        mujoco.mj_resetDataKeyframe(self.model, self.data, key)
        mujoco.mj_forward(self.model, self.data)

    def _see_actuators(self) -> None:
        """Find controls (nu,) at rest, where servos hold the pose, and how far actions reach."""
        model, ctrl, (low, high) = self.model, self.data.ctrl, self.model.actuator_ctrlrange.T
        offset, stiffness = model.actuator_biasprm[:, :2].T
        servo = (model.actuator_biastype == mjtBias.mjBIAS_AFFINE) & (stiffness != 0)
        servo &= model.actuator_dyntype != mjtDyn.mjDYN_INTEGRATOR  # controls are velocities
        gain = np.where(servo, model.actuator_gainprm[:, 0], 1.0)
        held = 0.0 - (offset + stiffness * self.data.actuator_length) / gain
        rest = ctrl.copy() if ctrl.any() else np.where(servo, held, (low + high) / 2)
        reach = np.where(model.actuator_ctrllimited, np.maximum(high - rest, rest - low), 1.0)
        reach = np.where(servo & self.floating, np.minimum(reach, STRIDE), reach)
        names = [model.actuator(number).name or f"actuator {number}" for number in range(model.nu)]
        self.actuators = list(zip(names, rest.tolist(), reach.tolist(), strict=True))

    def _act_at_random(self) -> None:
        """Measure power, contacts, and where the body goes."""
        model, data, random, rows, places = self.model, self.data, np.random.default_rng(0), [], []
        self.substeps = max(1, round(0.02 / model.opt.timestep))
        _, rest, reach = map(np.array, zip(*self.actuators, strict=True))
        warnings: list[str] = []  # which MuJoCo would print, and log in the working directory
        mujoco.set_mju_user_warning(warnings.append)
        for step in range(5 * TRIAL):
            if step % TRIAL == 0:
                self._restart()
            if step % HOLD == 0:
                data.ctrl[:] = rest + reach * random.uniform(-1, 1, model.nu)
            mujoco.mj_step(model, data, self.substeps)
            power = np.abs(data.actuator_force * data.actuator_velocity).sum()
            rows.append((power, data.ncon, data.nefc))
            places.append(data.xipos[self.body].copy())
        if warnings:
            warn_user(
                f"random actions are too much for this robot ({warnings[0].rstrip('.')}): use a "
                "smaller time step in its MJCF, more damping, or weaker motors."
            )
        self.power, _, _ = np.quantile(rows, 0.25, axis=0)
        _, self.contacts, self.constraints = np.max(rows, axis=0)
        box = np.quantile(places, (0.05, 0.95), axis=0)
        self.box, self.near = box.T.round(3).tolist(), np.linalg.norm(box[1] - box[0]) / 4
