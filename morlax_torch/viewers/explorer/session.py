"""Move one robot in real time, and encode its model and poses for the page."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...envs import MorlaxError, TimeStep
from ...envs.naming import title
from ...envs.worlds.design_space import DesignSpace
from ...envs.worlds.trees import horizontal
from ...evaluation.front import Front
from ...networks.policy import Policy
from ...runs.loading import load, load_front
from ..describing import described_task
from ..player import PUSH, Player
from .library import Choice

Weights = tuple[float, ...]  # a trade-off: not negative, and sums to one
Put = Callable[[Callable[[], None]], None]  # queues a call for the thread that moves the robots
MAX_LAG = 0.1  # s of delay to catch up with; the rest of a longer delay is dropped
# beginnings of messages to the page that are not JSON
MODEL, FRAME = (np.int32(kind).tobytes() for kind in (0, 1))
WEIGHT = 0.5  # length of an arrow that carries the robot's weight, in sizes of the robot


class Session(Player):
    """A robot that moves in real time.

    `front` is that of the policies, if it was evaluated. `opened` are the policies that it began
    with, the same object for sessions that look alike and can stand side by side.
    """

    def __init__(self, policy: Policy, front: Front | None):
        self.objectives, self.front = policy.objectives, front
        super().__init__(policy, (1 / len(self.objectives),) * len(self.objectives))
        self._due = 0.0
        self._clock: float | None = None
        self.last_episode: dict[str, Any] | None = None
        self.axes = horizontal(self.model, self.env.base)
        self.opened = policy
        self._directions = np.random.default_rng(0)

    def twin(self) -> Self:
        """Return another robot with the same policy, trade-off and command."""
        twin = type(self)(self.policy, self.front)
        twin.opened, twin.tradeoff, twin.schedule = self.opened, self.tradeoff, self.schedule
        twin.command = list(self.command)
        twin._clock, twin._due = self._clock, self._due
        return twin

    @property
    def design(self) -> list[float]:
        """The body's design parameters (d,)."""
        policy = self.policy
        if not len(policy.agent.context):
            return []
        return DesignSpace(policy.agent.designs).vector(policy.config.task.design).tolist()

    @property
    def reshaped(self) -> Policy | None:
        """The policy, if its body is not that of the checkpoint."""
        return None if self.policy.config.task == self.opened.config.task else self.policy

    def reshape(self, policy: Policy) -> None:
        """Go on with another body of this family, whose front is unknown."""
        command = self.command
        self.open(policy)
        self.command = command
        self.renew(policy, None)

    def renew(self, policy: Policy, front: Front | None) -> None:
        """Let other policies of this family act from the next control step."""
        self.policy, self.front = policy, front
        self.tradeoff = self.tradeoff  # of the new policies

    def advance(self, now: float, pace: float = 1.0) -> int:
        """Take the steps that are due at clock time `now` in seconds; returns how many.

        A pace of 1 is real time, and of 0 a pause.
        """
        elapsed, dt = 0.0 if self._clock is None else now - self._clock, self.env.dt
        self._clock = now
        self._due += min(elapsed, MAX_LAG) * pace
        steps = int(self._due / dt + 1e-9)
        self._due -= steps * dt
        for _ in range(steps):
            self.step()
        return steps

    def until_next(self, pace: float) -> float:
        """Return the clock seconds until the next step is due, at most `MAX_LAG`."""
        return min(max(self.env.dt - self._due, 0.0) / max(pace, 1e-9), MAX_LAG)

    def step(self) -> TimeStep:
        """Take one control step; if the episode is over, start a new one first."""
        if self.over:
            self.last_episode = {
                "returns": _finite(self.returns),
                "seconds": self.steps * self.env.dt,
                "fell": self.steps < self.env.episode_length,
            }
            self.reset()
        return super().step()

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; those of twins with one seed begin and are disturbed alike."""
        if seed is not None:
            self.env.reseed(seed)
            self._directions = np.random.default_rng(seed)
        super().reset()

    def push(self) -> None:
        """Add `PUSH` m/s to the robot's velocity, in a random direction of its horizontal axes."""
        kick = self._directions.normal(size=len(self.axes))
        velocity = self.env.physics.qvel[0]
        for dof, part in zip(self.axes, PUSH * kick / np.linalg.norm(kick), strict=True):
            velocity[dof] += part

    def tell(self, index: int, value: float) -> None:
        """Set one number of the command, by its index; it is clamped to the task's limits."""
        low, high = list(self.env.command_limits.values())[index]
        self.command[index] = min(max(value, low), high)

    def about(self) -> dict[str, Any]:
        """Describe the robot for a page, apart from its front, model and poses."""
        env, policy = self.env, self.policy
        parameters = policy.agent.designs if self.design else {}
        return {
            "title": title(policy.config.env),
            "motion": None if self.ghost is None else env.episode_length * env.dt,
            "design": {f"{k} ({x.unit})": [x.low, x.high] for k, x in parameters.items()} or None,
            **described_task(env),
        }

    def told(self) -> dict[str, Any]:
        """Describe its trade-off and its episode."""
        return {
            "tradeoff": self.tradeoff,
            "follows": self.schedule and self.follows,  # null: there is no trade-off over time
            "returns": _finite(self.returns),
            "counted": self.steps,
            "ended": self.last_episode,
            # m/s along x and, if it can move there, y
            "velocity": _finite(self.data.qvel[self.axes]),
            # W, mechanical, of the motors; absorbed power counts as positive too
            "power": _finite(np.abs(self.data.actuator_force * self.data.actuator_velocity).sum()),
        }


def policies_of(choice: Choice) -> tuple[Policy, Front | None]:
    """Load the policies of a checkpoint, and their front if there is one."""
    policy, front = load(choice.file), None
    with suppress(MorlaxError):
        front = load_front(choice.file)
    return policy, front


def _finite(values: ArrayLike) -> Any:
    """Return plain numbers, with 0 in place of those that JSON lacks."""
    values = np.asarray(values)
    return np.where(np.isfinite(values), values, 0.0).tolist()


def frame_bytes(sessions: Sequence[Session]) -> bytes | None:
    """Return steps, poses, contacts and ghosts as 32-bit floats; None: they are not finite."""
    parts = [FRAME]
    for session in sessions:
        data = session.data
        if not np.isfinite(data.xpos).all():
            return None
        arrows = contact_arrows(session.model, data)
        ghosts = [] if session.ghost is None else [session.ghost]
        numbers = [[session.steps, len(arrows), len(ghosts)], data.xpos, data.xquat, arrows]
        numbers += [part for ghost in ghosts for part in (ghost.xpos, ghost.xquat)]
        parts += [np.asarray(part, np.float32).tobytes() for part in numbers]
    return b"".join(parts)


def contact_arrows(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """Return arrows (n, 2, 3) of the forces by which the ground pushes the robot at contacts."""
    size = float(model.stat.extent)
    newtons = float(model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity))
    arrows, force = np.zeros((data.ncon, 2, 3)), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        contact = data.contact[i]
        push = contact.frame.reshape(3, 3).T @ force[:3]
        push *= np.copysign(WEIGHT * size / max(newtons, 1e-9), push[2])
        # no longer than the robot, because impacts are many times a weight
        push *= min(1.0, size / max(float(np.linalg.norm(push)), 1e-12))
        arrows[i] = contact.pos, contact.pos + push
    return arrows
