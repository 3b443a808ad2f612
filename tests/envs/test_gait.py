"""Film strips sample the gait cycle of a robot."""

import numpy as np
import pytest

from morlax_torch.viewers.filming.panels import cycle, moments

DT = 0.01


def swing(period: int, steps: int = 400, noise: float = 0.0) -> np.ndarray:
    """Return two joints (steps, 2) that swing with a period, and drift."""
    time = np.arange(steps)
    phase = 2 * np.pi * time / period
    joints = np.stack([np.sin(phase), 0.5 * np.cos(phase) + 0.3 * np.sin(2 * phase)], -1)
    shake = np.random.default_rng(0).normal(size=joints.shape)
    return 0.4 * joints + 0.001 * time[:, None] + noise * shake


@pytest.mark.parametrize("period", (12, 23, 40, 75, 150))
@pytest.mark.parametrize("noise", (0.0, 0.05))
def test_the_cycle_of_a_motion_is_found(period, noise):
    assert cycle(swing(period, noise=noise), DT) == pytest.approx(period, rel=0.03)


def test_a_robot_that_stands_or_stumbles_has_no_cycle():
    assert cycle(np.zeros((300, 3)), DT) is None
    assert cycle(np.zeros((300, 0)), DT) is None
    assert cycle(np.random.default_rng(0).normal(size=(300, 3)), DT) is None
    assert cycle(swing(20)[:3], DT) is None


def test_pictures_show_the_last_cycle_or_two():
    assert moments([swing(40)], DT, 9) == [[*range(359, 400, 5)]]
    (twice,) = moments([swing(12)], DT, 17)  # too few steps for 17 pictures
    assert twice[-1] == 399 and twice[-1] - twice[0] == 24
    still = np.zeros((400, 2))
    assert moments([still], DT, 5) == [[299, 324, 349, 374, 399]]  # one second
    assert moments([np.zeros((3, 2))], DT, 2) == [[0, 2]]
    fallen = swing(40)[:21]
    rows = moments([swing(40), swing(20), still, fallen], DT, 9)
    assert rows == [[*range(359, 400, 5)]] * 3 + [[0, 5, 10, 15, 20, 20, 20, 20, 20]]
