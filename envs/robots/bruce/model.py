"""The model of BRUCE, and the coordinates in which its joints are spoken of.

Crank coordinates (16) are the ones to think in: for the right and the left leg hip yaw, hip pitch,
hip roll, knee and ankle crank, then for the right and the left arm shoulder pitch, shoulder roll
and elbow. Actions, observations, gaits and rewards use them. Motor coordinates (16) differ in the
hips, where two motors turn pitch and roll together. All joints of a model, its `qpos` behind the
root, are linear in crank coordinates: the four-bar of the ankle is a parallelogram up to 0.12 mm.
"""

from importlib import resources
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

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
MOTORS = tuple(
    name.replace("hip_pitch", "hip_motor_a").replace("hip_roll", "hip_motor_b")
    for name in CRANK_JOINTS
)
_COUPLED = ("hip_pitch", "hip_roll", "knee", "ankle_crank")  # in full coordinates
NUM_LEG_JOINTS = 10  # of the 16, the first

DEFAULT_POSE = np.array(
    [
        *(-0.008, 0.469, 0.018, -0.947, -0.469),
        *(0.008, 0.469, -0.018, -0.947, -0.469),
        *(0.0, 1.0, 0.0),
        *(0.0, -1.0, 0.0),
    ]
)
DEFAULT_HEIGHT = 0.455  # metres: the soles hang 30 mm above the floor

SHORT_FOOT = 0.038  # metres: half the length of the left foot as it was published, 10 mm less


def load(chains: Chains = "closed", feet: Feet = "equal") -> mujoco.MjModel:
    """Compile the robot.

    Args:
        chains: "closed" has the differentials of the hips and the four-bars of the ankles. "tree"
            puts the motors on tendons instead, and leaves out rods, cranks and rotors (32 g): it is
            faster, and walks nearly alike.
        feet: "equal", or "published": there the left foot is 20 mm shorter than the right one, and
            the robot drifts sideways.
    """
    path = resources.files(str(__package__)) / "bruce.xml"
    spec = mujoco.MjSpec.from_string(path.read_text())
    if feet == "published":
        spec.geom("left_foot").size[0] = SHORT_FOOT
    if chains == "tree":
        _open_chains(spec)
    return spec.compile()


def joints_from_crank(model: mujoco.MjModel) -> NDArray[np.float64]:
    """(nq - 7, 16): crank coordinates to the hinges of `model`, in the order of `qpos`."""
    rules = {name: {name: 1.0} for name in CRANK_JOINTS}
    for side in SIDES:
        pitch, roll, knee, crank = (f"{side}_{j}" for j in _COUPLED)
        rules[f"{side}_ankle_pitch"] = {crank: 1.0, knee: -1.0}
        rules[f"{side}_ankle_rod_pin"] = {knee: 1.0, crank: -1.0}
        rules[f"{side}_hip_motor_a"] = {pitch: -1.0, roll: -1.0}
        rules[f"{side}_hip_motor_b"] = {pitch: 1.0, roll: -1.0}
    names = [model.joint(i).name for i in range(1, model.njnt)]
    return np.array([[rules[name].get(crank, 0.0) for crank in CRANK_JOINTS] for name in names])


def motors_from_crank() -> NDArray[np.float64]:
    """(16, 16): crank coordinates to those of the motors, in the order of `ctrl`."""
    matrix = np.eye(len(CRANK_JOINTS))
    for first in (0, 5):  # of each leg
        matrix[first + 1 : first + 3, first + 1 : first + 3] = [[-1.0, -1.0], [1.0, -1.0]]
    return matrix


def crank_from_joints(model: mujoco.MjModel) -> NDArray[np.float64]:
    """(16, nq - 7): the hinges of `model` to crank coordinates.

    With closed chains the hips are read where they are driven: from the motors.
    """
    names = [model.joint(i).name for i in range(1, model.njnt)]
    rules = {name: {name: 1.0} for name in CRANK_JOINTS}
    for side in SIDES:
        pitch, roll, knee, crank = (f"{side}_{j}" for j in _COUPLED)
        a, b = f"{side}_hip_motor_a", f"{side}_hip_motor_b"
        if a in names:
            rules[pitch], rules[roll] = {a: -0.5, b: 0.5}, {a: -0.5, b: -0.5}
        else:
            rules[crank] = {f"{side}_ankle_pitch": 1.0, knee: 1.0}
    return np.array([[rules[crank].get(name, 0.0) for name in names] for crank in CRANK_JOINTS])


def _open_chains(spec: mujoco.MjSpec) -> None:
    """Replace what closes the chains of a leg by tendons that pull as its motors would."""
    motor = spec.find_default("motor").joint
    gains = {a.name: (a.gainprm[0], a.forcerange[1]) for a in spec.actuators}
    for elements in (spec.sensors[2:], spec.actuators, spec.equalities, spec.tendons):
        for element in elements:
            spec.delete(element)
    pulls = {}
    for side in SIDES:
        for part in ("ankle_rod", "ankle_crank_arm", "hip_motor_a_rotor", "hip_motor_b_rotor"):
            spec.delete(spec.body(f"{side}_{part}"))
        pitch, roll, knee = (f"{side}_{joint}" for joint in ("hip_pitch", "hip_roll", "knee"))
        pulls[f"{side}_hip_motor_a"] = {pitch: -1.0, roll: -1.0}
        pulls[f"{side}_hip_motor_b"] = {pitch: 1.0, roll: -1.0}
        pulls[f"{side}_ankle_crank"] = {knee: 1.0, f"{side}_ankle_pitch": 1.0}
    for name, joints in pulls.items():
        tendon = spec.add_tendon(name=name, armature=motor.armature, damping=motor.damping)
        for joint, coefficient in joints.items():
            tendon.wrap_joint(joint, coefficient)
    for name in MOTORS:
        stiffness, force = gains[name]
        damping, _ = gains[f"{name}_damper"]
        force = force or motor.actfrcrange[1]
        spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_TENDON if name in pulls else mujoco.mjtTrn.mjTRN_JOINT,
            gainprm=[stiffness] + [0] * 9,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=[0, -stiffness, -damping] + [0] * 7,
            forcerange=[-force, force],
        )
        spec.add_sensor(
            name=f"{name}_torque",
            type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
            objtype=mujoco.mjtObj.mjOBJ_ACTUATOR,
            objname=name,
        )
