"""BRUCE's model, its joint coordinates and its domain randomization.

Crank coordinates (16) are the main ones; actions, observations, gaits and rewards use them. Their
order is hip yaw, hip pitch, hip roll, knee and ankle crank for the right and the left leg, then
shoulder pitch, shoulder roll and elbow for the right and the left arm. Motor coordinates (16)
differ in the hips, where two motors turn pitch and roll together. All joints of a model (its `qpos`
after the root) are linear in crank coordinates, because the four-bar of the ankle is a
parallelogram to within 0.12 mm.
"""

from collections.abc import Sequence
from importlib import resources
from typing import Literal

import mujoco
import numpy as np

from ...physics.interface import Fields

Chains = Literal["closed", "tree"]
Feet = Literal["equal", "published"]

SIDES = ("right", "left")
CRANK_JOINTS = tuple(
    f"{side}_{joint}"
    for joints in (
        ("hip_yaw", "hip_pitch", "hip_roll", "knee", "ankle_crank"),
        ("shoulder_pitch", "shoulder_roll", "elbow"),
    )
    for side in SIDES
    for joint in joints
)
MOTORS = tuple(  # in the order of `ctrl`
    name.replace("hip_pitch", "hip_motor_a").replace("hip_roll", "hip_motor_b")
    for name in CRANK_JOINTS
)
NUM_LEG_JOINTS = 10  # the first of the 16

DEFAULT_POSE = np.array(
    [
        *(-0.008, 0.469, 0.018, -0.947, -0.469),
        *(0.008, 0.469, -0.018, -0.947, -0.469),
        *(0.0, 1.0, 0.0),
        *(0.0, -1.0, 0.0),
    ]
)

SHORT_FOOT = 0.038  # m; half length of the published left foot, 10 mm less than the right
FIELDS = ("geom_friction", "body_mass", "body_ipos", "actuator_gainprm", "actuator_biasprm")
FRICTION, TORSO_MASS, GAIN = 0.4, 0.3, 0.2  # largest relative change, up or down
# Shifts of centers of mass along each axis, in m; the torso gets both.
TORSO_SHIFT, SHIFT = 0.05, 0.01
Array = np.ndarray


def load(chains: Chains = "closed", feet: Feet = "equal") -> mujoco.MjModel:
    """Compile the robot, see `BruceOptions`.

    "closed" models the differentials of the hips and the four-bars of the ankles; "tree" also omits
    rods, cranks and rotors (32 g).
    """
    path = resources.files(str(__package__)) / "bruce.xml"
    spec = mujoco.MjSpec.from_string(path.read_text())
    if feet == "published":
        spec.geom("left_foot").size[0] = SHORT_FOOT
    if chains == "tree":
        _open_chains(spec)
    return spec.compile()


def joints_from_crank(model: mujoco.MjModel) -> Array:
    """Return the map (nq - 7, 16) from crank coordinates to the hinges of `model`, as in `qpos`."""
    return from_crank([model.joint(i).name for i in range(1, model.njnt)])


def crank_from_joints(model: mujoco.MjModel) -> Array:
    """Return the map (16, nq - 7) from the hinges of `model` to crank coordinates.

    With closed chains, hip angles are read from the motors that drive them.
    """
    names = [model.joint(i).name for i in range(1, model.njnt)]
    read = MOTORS if set(MOTORS) <= set(names) else names
    matrix = np.zeros((len(CRANK_JOINTS), len(names)))
    matrix[:, [names.index(name) for name in read]] = np.linalg.inv(from_crank(read))
    return matrix


def from_crank(hinges: Sequence[str]) -> Array:
    """Return the map (n, 16) from crank coordinates to n hinges, such as MOTORS."""
    rules = {name: {name: 1.0} for name in CRANK_JOINTS}
    for side in SIDES:
        pitch, roll = f"{side}_hip_pitch", f"{side}_hip_roll"
        knee, crank = f"{side}_knee", f"{side}_ankle_crank"
        rules[f"{side}_hip_motor_a"] = {pitch: -1.0, roll: -1.0}
        rules[f"{side}_hip_motor_b"] = {pitch: 1.0, roll: -1.0}
        rules[f"{side}_ankle_pitch"] = {crank: 1.0, knee: -1.0}
        rules[f"{side}_ankle_rod_pin"] = {knee: 1.0, crank: -1.0}
    return np.array([[rules[name].get(crank, 0.0) for crank in CRANK_JOINTS] for name in hinges])


def _open_chains(spec: mujoco.MjSpec) -> None:
    """Replace the closed chains of the legs by tendons that transmit the same motor forces."""
    motor = spec.find_default("motor").joint
    for torque in spec.sensors[2:]:  # named like their joints, as actuators are
        torque.type = mujoco.mjtSensor.mjSENS_ACTUATORFRC
        torque.objtype = mujoco.mjtObj.mjOBJ_ACTUATOR
    for name in MOTORS:
        servo, damper = spec.actuator(name), spec.actuator(f"{name}_damper")
        force = servo.forcerange[1] or motor.actfrcrange[1]
        servo.biasprm[2], servo.forcerange = -damper.gainprm[0], [-force, force]
        servo.ctrlrange = [0, 0]  # unlimited
        spec.delete(damper)
    for element in (*spec.equalities, *spec.tendons):
        spec.delete(element)
    for side in SIDES:
        pitch, roll, knee = (f"{side}_{joint}" for joint in ("hip_pitch", "hip_roll", "knee"))
        for name, joints in (
            (f"{side}_hip_motor_a", {pitch: -1.0, roll: -1.0}),
            (f"{side}_hip_motor_b", {pitch: 1.0, roll: -1.0}),
            (f"{side}_ankle_crank", {knee: 1.0, f"{side}_ankle_pitch": 1.0}),
        ):
            spec.actuator(name).trntype = mujoco.mjtTrn.mjTRN_TENDON
            tendon = spec.add_tendon(name=name, armature=motor.armature, damping=motor.damping)
            for joint, coefficient in joints.items():
                tendon.wrap_joint(joint, coefficient)
        for part in ("ankle_rod", "ankle_crank_arm", "hip_motor_a_rotor", "hip_motor_b_rotor"):
            spec.delete(spec.body(f"{side}_{part}"))


def randomized(model: mujoco.MjModel, fields: Fields, num_worlds: int, seed: int) -> Fields:
    """Draw the model fields (N, ...) that differ between worlds, on top of `fields`."""
    random = np.random.default_rng([seed, 1])  # a stream independent of the one that drew `fields`

    def around(center: float, width: float, *shape: int) -> Array:
        return random.uniform(center - width, center + width, (num_worlds, *shape))

    nominal = {name: [getattr(model, name)] * num_worlds for name in FIELDS}
    drawn = {name: np.array(values) for name, values in {**nominal, **fields}.items()}
    torso = model.body("torso").id
    drawn["geom_friction"][:, model.geom("floor").id, 0] *= around(1, FRICTION)
    drawn["body_mass"][:, torso] *= around(1, TORSO_MASS)
    drawn["body_ipos"][:, 1:] += around(0, SHIFT, model.nbody - 1, 3)
    drawn["body_ipos"][:, torso] += around(0, TORSO_SHIFT, 3)
    gain = around(1, GAIN, model.nu, 1)
    drawn["actuator_gainprm"] *= gain
    drawn["actuator_biasprm"] *= gain
    return drawn
