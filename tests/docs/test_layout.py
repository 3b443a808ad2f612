"""Observation layouts are correct: moving a joint changes only the entries named after it."""

import mujoco
import pytest
from torch import Tensor

from morlax_torch import envs

TASKS = {name: {} for name in envs.names() if name != "bruce"}  # which observes a history
TASKS["humanoid with hands"] = {"extremities": True}
SENSORS = {
    "head": {"position.head.z"},
    "torso_x": {"torso.x.z"},
    "torso_y": {"torso.y.z"},
    "torso_z": {"torso.z.z"},
    "velocity": {"velocity.center"},
    "center": set(),
    "right_hand": {"position.right_hand"},
    "left_foot": {"position.left_foot"},
}


@pytest.fixture(params=TASKS)
def env(request: pytest.FixtureRequest) -> envs.Environment:
    return envs.make(request.param.split()[0], 1, "cpu", "mujoco", **TASKS[request.param])


def changed_by(env: envs.Environment, state: Tensor, address: int, by: float = 0.25) -> set[str]:
    """Return the parts of the observation that change with one entry of the state."""
    before, was = env.observe().clone(), state[0, address].clone()
    state[0, address] += by
    change = (env.observe() != before)[0]
    state[0, address] = was
    sizes = [part.size for part in env.layout()]
    names = [part.name for part in env.layout()]
    return {name for name, own in zip(names, change.split(sizes), strict=True) if own.any()}


def names(kind: str, joint: str, free: tuple[str, ...], type: int) -> tuple[str, ...]:
    if type == mujoco.mjtJoint.mjJNT_FREE:
        return tuple(f"{kind}.{joint}.{name}" for name in free)
    return (f"{kind}.{joint}",)


def test_a_position_changes_only_the_part_named_after_it(env):
    model, known = env.physics.model, {part.name for part in env.layout()}
    free = ("x", "y", "z", *("quaternion",) * 4)
    for index, type in enumerate(model.jnt_type):
        joint = model.joint(index)
        for offset, name in enumerate(names("position", joint.name, free, type)):
            assert changed_by(env, env.physics.qpos, joint.qposadr[0] + offset) == {name} & known


def test_a_velocity_changes_only_the_part_named_after_it(env):
    model = env.physics.model
    free = (*("linear",) * 3, *("angular",) * 3)
    for index, type in enumerate(model.jnt_type):
        joint = model.joint(index)
        for offset, name in enumerate(names("velocity", joint.name, free, type)):
            assert changed_by(env, env.physics.qvel, joint.dofadr[0] + offset) == {name}


def test_a_sensor_changes_only_the_parts_that_read_it():
    for extremities in (False, True):
        env = envs.make("humanoid", 1, "cpu", "mujoco", extremities=extremities)
        known = {part.name for part in env.layout()}
        for sensor, expected in SENSORS.items():
            address = env.physics.model.sensor(sensor).adr[0] + 2  # z
            assert changed_by(env, env.physics.sensors, address) == expected & known


def test_units_state_which_velocities_are_clipped(env):
    env.physics.qvel.fill_(1000.0)
    seen = env.observe()[0].split([part.size for part in env.layout()])
    for part, values in zip(env.layout(), seen, strict=True):
        if part.name.startswith("velocity.") and part.name != "velocity.center":
            assert values.unique().tolist() == [10.0 if "[-10, 10]" in part.unit else 1000.0]


def test_a_ball_joint_has_a_quaternion_and_an_angular_velocity():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="hip" type="ball"/><geom size="1"/></body>'
        "</worldbody></mujoco>"
    )
    assert envs.positions(model) == [("position.hip.quaternion", 4, "w, x, y, z")]
    assert envs.velocities(model) == [("velocity.hip.angular", 3, "rad/s, in the body")]
    assert (model.nq, model.nv) == (4, 3)
