"""The walk that N worlds are to follow: gaits of the library, blended as velocities change.

Each world follows a segment: what is left of its step, re-parametrised to [0, 1]. All of it is
arithmetic on whole tensors, written in place, so that a CUDA graph can record it.
"""

from math import comb

import torch
from torch import Tensor

from .library import Library
from .planner import DEGREE

BLENDING = 0.7  # of a step: later ones are not changed
LATE = 0.005  # seconds that a step has run when it begins, half the lag of noticing it
EARLY = 0.01  # and when an episode begins


class Reference:
    """State of the walk of N worlds; every tensor is a world's row.

    Args:
        library: of gaits, all with the same duration of a step.
        like: (N, ...) whose number of worlds, dtype and device to take.
    """

    def __init__(self, library: Library, like: Tensor):
        curves = torch.cat([torch.from_numpy(library.joints), torch.from_numpy(library.base)], -1)
        self.step_time = library.constants.step_time
        self._gaits = curves.to(like).flatten(3)  # (X, Y, 2, 8 * 22)
        self._shape = curves.shape[3:]
        self._vx, self._vy = (torch.from_numpy(v).to(like) for v in (library.vx, library.vy))
        self._binomial = {
            n: like.new_tensor([[comb(n, k) for k in range(n + 1)], [*range(n + 1)]])[..., None]
            for n in (DEGREE - 1, DEGREE)
        }
        N = len(like)
        self.points = like.new_zeros(N, *self._shape)  # (N, 8, 22)
        self.duration = like.new_full((N,), self.step_time)  # s, of the segment
        self.elapsed = like.new_zeros(N)  # s, of the segment
        self.step_elapsed = like.new_zeros(N)  # s, of the step
        self.leg = torch.zeros(N, dtype=torch.int64, device=like.device)  # 0: the left one swings
        self.velocity = like.new_zeros(N, 2)  # m/s, that the segment was blended for

    @property
    def phase(self) -> Tensor:
        """(N,) how much of the step is over, from 0 to 1."""
        return self.step_elapsed / self.step_time

    def state(self) -> dict[str, Tensor]:
        """Every tensor that the future depends on."""
        names = ("points", "duration", "elapsed", "step_elapsed", "leg", "velocity")
        return {name: getattr(self, name) for name in names}

    def gaits(self, velocity: Tensor, leg: Tensor) -> Tensor:
        """(N, 8, 22): control points of a step with the legs (N,) at velocities (N, 2).

        They are bilinear in the library's grid.
        """
        i, u = _cell(self._vx, velocity[:, 0])
        j, v = _cell(self._vy, velocity[:, 1])
        near = torch.lerp(self._gaits[i, j, leg], self._gaits[i + 1, j, leg], u[:, None])
        far = torch.lerp(self._gaits[i, j + 1, leg], self._gaits[i + 1, j + 1, leg], u[:, None])
        return torch.lerp(near, far, v[:, None]).unflatten(1, self._shape)

    def begin(self, fresh: Tensor, velocity: Tensor, leg: Tensor) -> None:
        """Start walking anew where `fresh` (N,), for velocities (N, 2), on legs (N,)."""
        self._start_segment(fresh, velocity, leg, EARLY)
        self.velocity.copy_(torch.where(fresh[:, None], velocity, self.velocity))

    def blend(self, velocity: Tensor) -> None:
        """Turn towards the gaits for velocities (N, 2), where the step is not too far gone.

        What is left of the segment and what the new gait has left are split off; the new segment
        starts as the one and ends as the other.
        """
        open_ = self.phase < BLENDING
        done = self.elapsed / self.duration
        rest = self.duration - self.elapsed
        target = self.gaits(velocity, self.leg)
        old, new = self._rest(self.points, done), self._rest(target, 1 - rest / self.step_time)
        blended = torch.cat(
            [old[..., :3, :], (old[..., 3:5, :] + new[..., 3:5, :]) / 2, new[..., 5:, :]], -2
        )
        self.points.copy_(torch.where(open_[:, None, None], blended, self.points))
        self.duration.copy_(torch.where(open_, rest, self.duration))
        self.elapsed.masked_fill_(open_, 0.0)
        self.velocity.copy_(torch.where(open_[:, None], velocity, self.velocity))

    def advance(self, dt: float) -> Tensor:
        """Let time pass; returns where feet changed (N,) bool."""
        self.elapsed += dt
        self.step_elapsed += dt
        changed = self.elapsed >= self.duration
        self._start_segment(changed, self.velocity, 1 - self.leg, LATE)
        return changed

    def now(self) -> tuple[Tensor, Tensor]:
        """Joints and base now, and their rates: (N, 22) each."""
        s = (self.elapsed / self.duration).clamp(0, 1)
        slopes = DEGREE * self.points.diff(dim=1) / self.duration[:, None, None]
        # products of matrices would be rounded to TF32 where training allows that
        value = (self._bernstein(s, DEGREE) * self.points).sum(1)
        return value, (self._bernstein(s, DEGREE - 1) * slopes).sum(1)

    def _bernstein(self, s: Tensor, degree: int) -> Tensor:
        """(N, degree + 1, 1): the weights of a Bezier curve's control points at s (N,)."""
        choose, k = self._binomial[degree]
        s = s[:, None, None]
        return choose * s**k * (1 - s) ** (degree - k)

    def _start_segment(self, where: Tensor, velocity: Tensor, leg: Tensor, elapsed: float) -> None:
        points = self.gaits(velocity, leg)
        self.points.copy_(torch.where(where[:, None, None], points, self.points))
        self.leg.copy_(torch.where(where, leg, self.leg))
        self.duration.masked_fill_(where, self.step_time)
        self.elapsed.masked_fill_(where, elapsed)
        self.step_elapsed.masked_fill_(where, elapsed)

    @staticmethod
    def _rest(points: Tensor, s: Tensor) -> Tensor:
        """Control points of the part of the curves (N, 8, C) that lies behind s (N,)."""
        s = s[:, None, None]
        lasts = []
        for _ in range(DEGREE):  # de Casteljau
            lasts.append(points[..., -1:, :])
            points = torch.lerp(points[..., :-1, :], points[..., 1:, :], s)
        return torch.cat([points, *reversed(lasts)], -2)


def _cell(grid: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
    """The cell of an even grid that each value (N,) is in, and how far in: from 0 to 1."""
    spacing = (grid[-1] - grid[0]) / (len(grid) - 1)
    at = ((value - grid[0]) / spacing).clamp(0, len(grid) - 1)
    i = at.long().clamp(0, len(grid) - 2)  # even of what is not a number
    return i, at - i
