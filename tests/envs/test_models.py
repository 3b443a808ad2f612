"""The robot models match the published ones and move like independent reference physics."""

import importlib.resources

import numpy as np
import pytest
import reference_trajectories as generate
from same import reference

ASSETS = importlib.resources.files("morlax_torch.envs.robots") / "assets"

# Not compared: properties that depend on sensors, cameras and the appearance of the ground (the
# package keeps only the sensors that tasks read and draws an infinite ground plane around x = 0),
# and the limit margin of joints without limits, which nothing reads.
UNCOMPARED_SIZES = {"nsensor", "nsensordata"}
GROUND = 0  # geom id

TOLERANCE = 1e-9


def without_uncompared(facts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    compared = {fact: value.copy() for fact, value in facts.items()}
    compared["sizes"][np.isin(facts["sizes_names"], list(UNCOMPARED_SIZES))] = 0
    compared["geom_size"][GROUND] = 0.0
    compared["geom_pos"][GROUND, :2] = 0.0
    compared["jnt_margin"][~facts["jnt_limited"].astype(bool)] = 0.0
    return compared


@pytest.fixture(params=generate.TASKS)
def robot(request: pytest.FixtureRequest) -> str:
    return request.param


def test_the_model_matches_the_published_one(robot):
    published = {
        key.removeprefix("model_"): value
        for key, value in reference(robot).items()
        if key.startswith("model_")
    }
    model = generate.load(robot, ASSETS)
    found = without_uncompared(generate.facts(model, published))
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
    model = generate.load(robot, ASSETS)
    motors = [model.actuator(i).name for i in range(model.nu)]
    assert motors == [model.joint(i).name for i in model.actuator_trnid[:, 0]]


def test_our_models_reproduce_every_reference_array_without_warnings(robot, workplace):
    expected = reference(robot)
    arrays = generate.generated(robot, ASSETS, expected, mjx=False)
    assert set(expected) - set(arrays) == {"qpos_mjx_converged"}
    for name, array in arrays.items():
        if not name.startswith("model_") and name != "mujoco_version":
            assert generate.difference(array, expected[name]) < TOLERANCE, name
    assert list(workplace.iterdir()) == []  # where MuJoCo logs its warnings
