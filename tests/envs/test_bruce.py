"""BRUCE has the published masses, joints and motors, and stands."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from same import csv_rows

from morlax_torch.envs.robots.bruce import model as bruce

FACTS = Path(__file__).parents[1] / "reference" / "bruce.csv"
CHAINS = ("closed", "tree")


class Fact:
    """A body of the published model, and the joint that moves it."""

    def __init__(self, row: dict[str, str]):
        self.body, self.parent, self.joint = row["body"], row["parent"], row["joint"]
        pos, quat, com, moments, axis, limits = (
            np.array(row[column].split(), dtype=float)
            for column in ("pos", "quat", "com", "inertia", "axis", "range")
        )
        self.pos, self.com, self.axis, self.range = pos, com, axis, limits
        self.rotation = rotation(quat / np.linalg.norm(quat))
        xx, yy, zz, xy, xz, yz = moments
        self.inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        self.mass, self.armature, self.damping, self.force_limit = (
            float(row[column] or 0) for column in ("mass", "armature", "damping", "force_limit")
        )


def rotation(quat: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


@pytest.fixture(scope="module")
def facts() -> list[Fact]:
    return [Fact(row) for row in csv_rows(FACTS)]


@pytest.fixture(scope="module")
def closed() -> mujoco.MjModel:
    return bruce.load()


def test_bodies_and_joints_match_the_published_model(facts, closed):
    assert closed.nbody == len(facts) + 1
    for i, fact in enumerate(facts):
        body, joint = closed.body(i + 1), closed.joint(i)
        assert (body.name, joint.name) == (fact.body, fact.joint)
        np.testing.assert_allclose(body.mass, fact.mass, rtol=1e-9)
        np.testing.assert_allclose(body.ipos, fact.com, atol=1e-9)
        R = rotation(body.iquat)
        np.testing.assert_allclose(R @ np.diag(body.inertia) @ R.T, fact.inertia, atol=1e-10)
        if i:
            assert closed.body(body.parentid[0]).name == fact.parent
            np.testing.assert_allclose(body.pos, fact.pos, atol=1e-9)
            np.testing.assert_allclose(rotation(body.quat), fact.rotation, atol=1e-9)
            np.testing.assert_allclose(joint.axis, fact.axis)
            np.testing.assert_allclose(joint.range, fact.range)
            np.testing.assert_allclose(joint.damping, fact.damping)
            np.testing.assert_allclose(joint.armature, fact.armature)
            limits = closed.jnt_actfrcrange[i]
            np.testing.assert_allclose(limits, [-fact.force_limit, fact.force_limit])


def test_motors_have_the_published_gains_and_force_limits(closed):
    assert [closed.actuator(i).name for i in range(16)] == list(bruce.MOTORS)
    for i, name in enumerate(bruce.MOTORS):
        legs, servo, damper = i < 10, closed.actuator(i), closed.actuator(16 + i)
        stiffness, damping = (80, 2) if legs else (5, 0.1)
        assert closed.joint(servo.trnid[0]).name == closed.joint(damper.trnid[0]).name == name
        assert (servo.gainprm[0], *servo.biasprm[:3]) == (stiffness, 0, -stiffness, 0)
        assert (damper.gainprm[0], *damper.biasprm[:3]) == (damping, 0, 0, -damping)
        assert servo.forcerange.tolist() == ([0, 0] if legs else [-3, 3])
        assert damper.forcerange.tolist() == ([0, 0] if legs else [-1, 1])


def test_only_feet_and_floor_collide(closed):
    touching = [closed.geom(i).name for i in range(closed.ngeom) if closed.geom_contype[i]]
    assert touching == ["floor", "right_foot", "left_foot"]
    for name in touching[1:]:
        np.testing.assert_allclose(closed.geom(name).size, [0.048, 0.014, 0.0035])
        assert closed.geom(name).friction[0] == 0.8
    published = bruce.load(feet="published")
    np.testing.assert_allclose(published.geom("left_foot").size, [0.038, 0.014, 0.0035])


def test_at_the_default_pose_chains_are_closed_and_soles_level(closed):
    data = mujoco.MjData(closed)
    data.qpos[2] = 0.455  # m; the soles are 30 mm above the floor
    data.qpos[7:] = bruce.joints_from_crank(closed) @ bruce.DEFAULT_POSE
    mujoco.mj_forward(closed, data)
    assert data.ne == 10  # two tendons and a point for each leg
    assert np.abs(data.efc_pos[: data.ne]).max() < 1.5e-4  # m, rad
    for side in bruce.SIDES:
        assert data.site(f"{side}_sole").xpos[2] == pytest.approx(0.03, abs=1e-4)


@pytest.mark.parametrize("chains", CHAINS)
def test_crank_joint_and_motor_coordinates_are_consistent(chains):
    model = bruce.load(chains)
    data = mujoco.MjData(model)
    crank = np.random.default_rng(0).uniform(-0.3, 0.3, 16)
    data.qpos[7:] = bruce.joints_from_crank(model) @ crank
    mujoco.mj_forward(model, data)
    back = bruce.crank_from_joints(model)
    np.testing.assert_allclose(back @ bruce.joints_from_crank(model), np.eye(16), atol=1e-15)
    measured = data.actuator_length[:16]
    np.testing.assert_allclose(measured, bruce.from_crank(bruce.MOTORS) @ crank, atol=1e-12)


def standing(model: mujoco.MjModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions and control of a standing pose: the default one, leaning back slightly."""
    crank = bruce.DEFAULT_POSE.copy()
    crank[[4, 9]] -= 0.03
    qpos, ctrl = np.zeros(model.nq), np.zeros(model.nu)
    qpos[2:4] = 0.4255, 1.0
    qpos[7:] = bruce.joints_from_crank(model) @ crank
    ctrl[:16] = bruce.from_crank(bruce.MOTORS) @ crank
    return qpos, ctrl


@pytest.mark.parametrize("chains", CHAINS)
def test_it_stands_with_little_torque_and_closed_chains(chains):
    model = bruce.load(chains)
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = standing(model)
    mujoco.mj_step(model, data, nstep=1250)
    assert data.qpos[2] == pytest.approx(0.4215, abs=1e-3)  # m, after 5 s
    torques = [data.sensor(f"{name}_torque").data[0] for name in bruce.MOTORS]
    assert 8 < np.square(torques).sum() < 11
    if chains == "closed":
        assert np.abs(data.efc_pos[: data.ne]).max() < 3e-4
