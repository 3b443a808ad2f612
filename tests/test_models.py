"""The robot models match the published ones and move like independent reference physics."""

import importlib.resources
from pathlib import Path

import mujoco
import numpy as np
import pytest

ROBOTS = ("cheetah", "walker", "hopper", "ant", "humanoid")
REFERENCE = Path(__file__).parent / "reference"

# Not compared: properties that depend on sensors, cameras and the appearance of the ground (the
# package keeps only the sensors that tasks read and draws an infinite ground plane around x = 0),
# and the limit margin of joints without limits, which nothing reads.
UNCOMPARED_SIZES = {"nsensor", "nsensordata"}
GROUND = 0  # geom id

TOLERANCE = 1e-9


def load(name: str) -> mujoco.MjModel:
    assets = importlib.resources.files("morlax_torch.envs.robots") / "assets"
    return mujoco.MjModel.from_xml_path(str(assets / f"{name}.xml"))


def control(name: str, action: np.ndarray, scale: float) -> np.ndarray:
    scaled = scale * action
    return scaled if name in ("hopper", "humanoid") else scaled.clip(-1, 1)


def names(model: mujoco.MjModel, kind: mujoco.mjtObj, count: int) -> list[str]:
    return [mujoco.mj_id2name(model, kind, i) or "" for i in range(count)]


def facts_of(model: mujoco.MjModel, published: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the properties of `model` under the names of the published ones."""
    special = {
        "total_mass": model.body_mass.sum(),
        "sizes": [getattr(model, size) for size in published["sizes_names"]],
        "opt": [
            model.opt.gravity["xyz".index(option[1])]
            if option in ("gx", "gy", "gz")
            else getattr(model.opt, option)
            for option in published["opt_names"]
        ],
        "actuator_joint": [model.joint(i).name for i in model.actuator_trnid[:, 0]],
        "body_names": names(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody),
        "joint_names": names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt),
        "geom_names": names(model, mujoco.mjtObj.mjOBJ_GEOM, model.ngeom),
        "sizes_names": published["sizes_names"],
        "opt_names": published["opt_names"],
    }
    return {
        fact: np.array(special[fact] if fact in special else getattr(model, fact))
        for fact in published
    }


def without_uncompared(facts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    compared = {fact: value.copy() for fact, value in facts.items()}
    compared["sizes"][np.isin(facts["sizes_names"], list(UNCOMPARED_SIZES))] = 0
    compared["geom_size"][GROUND] = 0.0
    compared["geom_pos"][GROUND, :2] = 0.0
    compared["jnt_margin"][~facts["jnt_limited"].astype(bool)] = 0.0
    return compared


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def reference(robot: str) -> dict[str, np.ndarray]:
    with np.load(REFERENCE / f"{robot}.npz") as file:
        return dict(file)


def test_the_model_matches_the_published_one(robot, reference):
    published = {
        key.removeprefix("model_"): value
        for key, value in reference.items()
        if key.startswith("model_")
    }
    found = without_uncompared(facts_of(load(robot), published))
    published = without_uncompared(published)

    unnamed = published["body_names"] == ""  # the published ant's lower legs have no names
    published["body_names"] = np.where(unnamed, found["body_names"], published["body_names"])

    for fact, value in published.items():
        assert found[fact].shape == value.shape, fact
        if value.dtype.kind == "U":
            assert found[fact].tolist() == value.tolist(), fact
        else:
            np.testing.assert_allclose(found[fact], value, rtol=0, atol=TOLERANCE, err_msg=fact)


def test_motors_are_named_after_the_joints_they_turn(robot):
    model = load(robot)
    motors = names(model, mujoco.mjtObj.mjOBJ_ACTUATOR, model.nu)
    assert motors == [model.joint(i).name for i in model.actuator_trnid[:, 0]]


@pytest.mark.parametrize("seed", (0, 1))
def test_stored_actions_reproduce_the_reference_trajectory_without_warnings(
    robot, reference, seed, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings here
    model = load(robot)
    data = mujoco.MjData(model)
    data.qpos = reference["qpos"][seed, 0]
    controls = control(robot, reference["action"][seed], reference["action_scale"])

    trajectory = []
    for u in controls[:100]:
        data.ctrl = u
        mujoco.mj_step(model, data, nstep=int(reference["n_substeps"]))
        trajectory.append(data.qpos.copy())

    expected = reference["qpos"][seed, 1:101]
    np.testing.assert_allclose(trajectory, expected, rtol=0, atol=TOLERANCE)
    assert list(tmp_path.iterdir()) == []
