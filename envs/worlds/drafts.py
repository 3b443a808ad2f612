"""First drafts of task files, from nothing but an MJCF. Imports no torch."""

import json
from pathlib import Path
from textwrap import shorten

import jinja2
import mujoco
import numpy as np

from ..errors import MorlaxError, user_code
from .trees import base_of, horizontal

CONTROL_STEP = 0.02  # s
STRIDE = 0.5  # rad or m, by which servos of a robot that can fall leave the start pose at most
STEPS, TRIAL, HOLD = 500, 100, 10  # control steps at random, in a trial of them, of an action
BALL = int(mujoco.mjtJoint.mjJNT_BALL)  # below it is the free joint, above those of one number


class Draft:
    """A task for the robot of an MJCF, whose attributes fill in draft.jinja.

    Raises:
        MorlaxError: MuJoCo cannot load the MJCF, or it lacks actuators, a floor or names.
    """

    def __init__(self, path: Path):
        with user_code(f"MuJoCo cannot load {path}"):
            self.model = model = mujoco.MjSpec.from_file(str(path)).compile()
        self._path, self._data = path, mujoco.MjData(model)
        if not model.nu:
            names = (model.joint(number).name for number in np.flatnonzero(model.jnt_type > BALL))
            motor = f'<actuator><motor joint="{next(names, "hip")}" ctrlrange="-20 20"/></actuator>'
            raise self._refusal("actuators", f"add one for each driven joint, such as {motor}")
        keys = [model.key(number).name for number in range(model.nkey)]
        self.key = next((key for key in ("home", "stand", *keys) if key and key in keys), None)
        self._restart()
        self._see_body()
        self._see_actuators()
        self._act_at_random()

    def text(self, name: str, model_file: str) -> str:
        """Return the text of a Python file that defines the class `name`."""
        loader = jinja2.PackageLoader(str(__package__), "")
        templates = jinja2.Environment(loader=loader, trim_blocks=True, lstrip_blocks=True)
        templates.filters |= {"quoted": json.dumps, "short": _short}
        template = templates.get_template("draft.jinja")
        return template.render(vars(self), name=name, model_file=model_file)

    def _refusal(self, lack: str, remedy: str) -> MorlaxError:
        return MorlaxError(f"{self._path} has no {lack}: {remedy}.")

    def _restart(self) -> None:
        key = -1 if self.key is None else self.model.key(self.key).id
        mujoco.mj_resetDataKeyframe(self.model, self._data, key)
        mujoco.mj_forward(self.model, self._data)

    def _see_body(self) -> None:
        """Find whether the robot can fall, and its base or end effector."""
        model, data, base = self.model, self._data, base_of(self.model)
        along = horizontal(model, base)  # degrees of freedom that move the base along the floor
        joints, fixed = model.dof_jntid[along], model.body_weldid[model.geom_bodyid] == 0
        free, driven = model.jnt_type[joints] < BALL, np.isin(joints, model.actuator_trnid[:, 0])
        self.floating = bool(free.any() or (along and not driven.any()))
        if free.any() and not (model.geom_contype[fixed] | model.geom_conaffinity[fixed]).any():
            remedy = 'name a scene that has one, or add <geom type="plane" size="0 0 1"/> to it'
            raise self._refusal("floor below its robot", remedy)
        first = self.floating and along == list(range(len(along)))
        self.unobserved = len(along) if first else 0  # leading numbers of qpos
        self.height, self.upright = data.xpos[base, 2], data.xmat[base, 8] > 0.9
        robot = np.flatnonzero(model.body_treeid == model.body_treeid[base])
        leaves = robot[~np.isin(robot, model.body_parentid)]
        far = np.linalg.norm(data.xipos[leaves] - data.xpos[base], axis=1)
        self._body = base if self.floating else leaves[far.argmax()]
        self.body = model.body(self._body).name
        if not self.body:
            raise self._refusal("names of bodies", 'add them, such as <body name="hand">')
        self.sensors = shorten(", ".join(model.sensor(i).name for i in range(model.nsensor)), 60)

    def _see_actuators(self) -> None:
        """Find controls (nu,) at rest, where servos hold the pose, and how far actions reach."""
        model, data = self.model, self._data
        low, high = model.actuator_ctrlrange.T
        offset, stiffness = model.actuator_biasprm[:, :2].T
        servo = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) & (stiffness != 0)
        gain = np.where(servo, model.actuator_gainprm[:, 0], 1.0)
        held = -(offset + stiffness * data.actuator_length) / gain
        rest = data.ctrl.copy() if data.ctrl.any() else np.where(servo, held, (low + high) / 2)
        reach = np.maximum(high - rest, rest - low)
        reach[model.actuator_ctrllimited == 0] = 1.0
        reach[servo & self.floating] = reach[servo & self.floating].clip(max=STRIDE)
        names = (model.actuator(number).name or f"actuator {number}" for number in range(model.nu))
        self.actuators, self._ranges = list(zip(names, rest, reach, strict=True)), (rest, reach)

    def _act_at_random(self) -> None:
        """Measure power, contacts, and where the end effector goes."""
        model, data, random = self.model, self._data, np.random.default_rng(0)
        (rest, reach), rows, places = self._ranges, [], []
        self.substeps = max(1, round(CONTROL_STEP / model.opt.timestep))
        for step in range(STEPS):
            if step % TRIAL == 0:
                self._restart()
            if step % HOLD == 0:
                data.ctrl[:] = rest + reach * random.uniform(-1, 1, model.nu)
            mujoco.mj_step(model, data, self.substeps)
            power = np.abs(data.actuator_force * data.actuator_velocity).sum()
            rows.append((power, data.ncon, data.nefc))
            places.append(data.xipos[self._body].copy())
        self.power, *_ = np.quantile(rows, 0.25, axis=0)
        _, self.contacts, self.constraints = np.max(rows, axis=0)
        low, high = np.quantile(places, (0.05, 0.95), axis=0)
        self.near = np.linalg.norm(high - low) / 4
        self.box = [(_short(a), _short(b)) for a, b in zip(low, high, strict=True)]


def _short(value: float) -> float:
    return float(f"{value:.3g}") + 0.0  # not -0.0
