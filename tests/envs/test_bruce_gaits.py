"""The shipped gaits respect their limits, match the planner, and walk."""

import numpy as np
import plan_gaits
import pytest
from gait_acceptance import LIMITS, MIN_WALKED, STEPS, measure
from gait_library import FORWARD, SIDEWAYS, Library
from gait_planner import Planner
from gait_walk import Walker

from morlax_torch import MorlaxError

SOME = ((0, 8), (8, 4), (13, 5))  # rows and columns of the library: a corner, standing, walking


@pytest.fixture(scope="module")
def library() -> Library:
    return Library.load()


@pytest.fixture(scope="module")
def planner(library: Library) -> Planner:
    return Planner(library.constants)


def test_every_gait_respects_the_limits_and_most_walk_in_simulation(library):
    assert library.joints.shape == (17, 9, 2, 8, 16)
    assert library.base.shape == (17, 9, 2, 8, 6)
    np.testing.assert_array_equal(library.vx, FORWARD)
    np.testing.assert_array_equal(library.vy, SIDEWAYS)
    assert set(library.measured) == set(LIMITS)
    for name, (least, most) in LIMITS.items():
        values = library.measured[name]
        assert values.shape == (17, 9)
        assert least <= values.min() <= values.max() <= most, name
    assert library.measured["yaw_moment"][:, 4].max() < 1.4  # N m, of straight gaits
    assert (library.walked == STEPS).sum() >= MIN_WALKED


@pytest.mark.parametrize("place", SOME)
def test_planning_again_reproduces_the_shipped_gait(library, planner, place):
    vx, vy = library.vx[place[0]], library.vy[place[1]]
    gait = planner.plan(vx, vy)
    np.testing.assert_allclose(gait.joints, library.joints[place], rtol=0, atol=1e-6)
    np.testing.assert_allclose(gait.base, library.base[place], rtol=0, atol=1e-6)
    for name, value in measure(planner, library.gait(*place), vx, vy).items():
        assert value == pytest.approx(library.measured[name][place], rel=1e-3, abs=1e-6), name


def test_a_shipped_gait_walks_forward(library, planner):
    walker = Walker(planner)
    assert walker.walk(library.gait(10, 4), STEPS) == STEPS
    x, y, _ = walker.data.qpos[:3]
    assert 0.25 < x < 0.6  # m: 10 s at 0.05 m/s, minus some slip
    assert abs(y) < 0.2


def test_left_and_right_gaits_mirror_each_other(library):
    left, right = library.gait(12, 7), library.gait(12, 1)
    sides = [*range(5, 10), *range(5), *range(13, 16), *range(10, 13)]
    signs = np.array([-1, 1, -1, 1, 1] * 2 + [-1] * 6)
    # legs, arms and steps swap sides; the two sides of the robot differ slightly in mass
    np.testing.assert_allclose(left.joints, right.joints[::-1, :, sides] * signs, atol=3e-3)
    np.testing.assert_allclose(left.base, right.base[::-1] * ([1, -1] * 3), atol=1e-3)


def test_the_command_writes_a_library_and_its_table(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(plan_gaits, "FORWARD", FORWARD[12:13])
    monkeypatch.setattr(plan_gaits, "SIDEWAYS", SIDEWAYS[4:5])
    plan_gaits.main(tmp_path / "gaits.npz")
    with np.load(tmp_path / "gaits.npz") as file:
        assert file["joints"].shape == (1, 1, 2, 8, 16)
    printed = capsys.readouterr().out
    assert "1 of 1" in printed
    assert all(name in printed for name in LIMITS)
    with pytest.raises(MorlaxError, match="cannot write"):
        plan_gaits.main(tmp_path / "missing" / "gaits.npz")
