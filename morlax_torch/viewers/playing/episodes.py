"""Episodes without a window: how often a robot falls, how well it walks, and at which power."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...envs import MorlaxError
from ...host.phases import phase
from .deployment import Export
from .disturbances import Disturbances
from .policy import Policy
from .robot import Array, Robot

PERIODS = 3.0, 8.0  # s for which a command or a trade-off is wished for
STANDING = 0.1  # share of the commands that are to stand still


class Episode(NamedTuple):
    """What an episode came to; means are over its control steps."""

    falls: float
    seconds: float  # until the fall, if there was one
    error: float  # m/s, between commanded and actual horizontal velocity
    power: float  # W, positive mechanical power of all joints
    speed: float  # m/s, horizontal
    weight: float  # N, of the robot

    @property
    def transport(self) -> float:
        """Return the cost of transport: power / (weight * speed)."""
        return self.power / max(self.weight * self.speed, 1e-9)


class Wishes:
    """Draws commands within the ranges and trade-offs on the simplex, each for some seconds."""

    def __init__(self, deployment: Export, rng: np.random.Generator):
        self._low, self._high = np.array(deployment.settings.limits).T
        self._rng = rng
        self._until = [0.0, 0.0]  # s: of the command and the trade-off
        self._command = np.zeros(3)

    def command(self, seconds: float, policy: Policy) -> Array:
        """Return the command (3,) at this time, and tell the policy its trade-off."""
        if seconds >= self._until[0]:
            self._until[0] = seconds + self._rng.uniform(*PERIODS)
            walks = self._rng.random() >= STANDING
            self._command = walks * self._rng.uniform(self._low, self._high)
        if seconds >= self._until[1]:
            self._until[1] = seconds + self._rng.uniform(*PERIODS)
            target = self._rng.dirichlet(np.ones(len(policy.objectives)))
            policy.choose(target, at_once=seconds == 0)
        return self._command


def run(
    deployment: Export,
    disturbances: Disturbances | None,
    episodes: int,
    seconds: float = 30.0,
    seed: int = 0,
) -> list[Episode]:
    """Run episodes under random commands and trade-offs, which end with a fall.

    Raises:
        MorlaxError: there is no episode, or it has no control step.
    """
    check_times(deployment, seconds)
    if episodes < 1:
        raise MorlaxError(f"--episodes must be at least 1, not {episodes}.")
    policy, found = policy_of(deployment), []
    for number in range(episodes):
        phase("playing", number / episodes)
        draws, wishes = np.random.SeedSequence([seed, number]).spawn(2)
        robot = Robot(deployment, disturbances, draws)
        wished = Wishes(deployment, np.random.default_rng(wishes))
        found.append(_episode(robot, policy, wished, round(seconds / robot.dt)))
    return found


def check_times(deployment: Export, seconds: float) -> None:
    step = deployment.settings.step_dt
    if not step <= seconds <= 1e6:
        raise MorlaxError(f"--seconds must be from {step:g} to 1000000, not {seconds:g}.")


def policy_of(deployment: Export) -> Policy:
    own, seconds = deployment.settings.morlax_torch, deployment.settings.step_dt
    return Policy(deployment.policy, own.objectives, own.slew, seconds)


def summary(episodes: Sequence[Episode]) -> Episode:
    """Return the number of falls, and means weighted by time."""
    times = np.array([episode.seconds for episode in episodes])
    means = np.average(np.array(episodes), axis=0, weights=times)
    return Episode(
        sum(episode.falls for episode in episodes), float(times.sum()), *means[2:].tolist()
    )


def _episode(robot: Robot, policy: Policy, wishes: Wishes, steps: int) -> Episode:
    errors, powers, speeds, fallen = [], [], [], False
    for step in range(steps):
        command = wishes.command(step * robot.dt, policy)
        made = robot.step(policy.act(robot.observe(command)))
        fallen = made.fallen
        if fallen:
            break
        errors.append(np.linalg.norm(command[:2] - made.velocity[:2]))
        speeds.append(np.linalg.norm(made.velocity[:2]))
        powers.append(made.power)
    error, power, speed = (float(np.mean(rows or [np.nan])) for rows in (errors, powers, speeds))
    seconds = (len(errors) + fallen) * robot.dt
    return Episode(float(fallen), seconds, error, power, speed, robot.weight())
