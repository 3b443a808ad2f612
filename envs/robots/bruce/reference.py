"""Reference walk of N worlds: gaits of the library, blended when the velocity changes.

Each world follows a segment: the rest of its current step, reparametrized to [0, 1]. All updates
are in-place arithmetic on whole tensors, so that a CUDA graph can record them.
"""

from math import comb

import torch
from torch import Tensor

from .library import Library
from .planner import DEGREE

BLENDING = 0.7  # phase after which a step is no longer changed
LATE = 0.005  # s already elapsed when a step begins: half the lag in detecting its start
EARLY = 0.01  # s already elapsed when an episode begins


class Reference:
    """State of the reference walk; each tensor has one row per world.

    Args:
        library: gaits with one common step duration.
        like: (N, ...) tensor that sets the number of worlds, dtype and device.
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
        self.leg = torch.zeros(N, dtype=torch.int64, device=like.device)  # 0: left swings
        self.velocity = like.new_zeros(N, 2)  # m/s, of the segment

    @property
    def phase(self) -> Tensor:
        """Return the elapsed share (N,) of the step, from 0 to 1."""
        return self.step_elapsed / self.step_time

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that persists between steps, by name."""
        names = ("points", "duration", "elapsed", "step_elapsed", "leg", "velocity")
        return {name: getattr(self, name) for name in names}

    def gaits(self, velocity: Tensor, leg: Tensor) -> Tensor:
        """Interpolate the control points (N, 8, 22) of a step bilinearly in the library's grid.

        Args:
            velocity: (N, 2) in m/s, forward and to the left.
            leg: (N,) swing leg, 0 left and 1 right.
        """
        i, u = _cell(self._vx, velocity[:, 0])
        j, v = _cell(self._vy, velocity[:, 1])
        near = torch.lerp(self._gaits[i, j, leg], self._gaits[i + 1, j, leg], u[:, None])
        far = torch.lerp(self._gaits[i, j + 1, leg], self._gaits[i + 1, j + 1, leg], u[:, None])
        return torch.lerp(near, far, v[:, None]).unflatten(1, self._shape)

    def begin(self, fresh: Tensor, velocity: Tensor, leg: Tensor) -> None:
        """Restart the walk where `fresh` (N,) bool, with velocities (N, 2) and swing legs (N,)."""
        self._start_segment(fresh, velocity, leg, EARLY)
        self.velocity.copy_(torch.where(fresh[:, None], velocity, self.velocity))

    def blend(self, velocity: Tensor) -> None:
        """Blend toward the gaits for velocities (N, 2) where the phase is below BLENDING.

        The rests of the current segment and of the new gait are split off; the new segment starts
        like the former and ends like the latter.
        """
        blendable = self.phase < BLENDING
        done = self.elapsed / self.duration
        rest = self.duration - self.elapsed
        target = self.gaits(velocity, self.leg)
        old, new = self._rest(self.points, done), self._rest(target, 1 - rest / self.step_time)
        blended = torch.cat(
            [old[..., :3, :], (old[..., 3:5, :] + new[..., 3:5, :]) / 2, new[..., 5:, :]], -2
        )
        self.points.copy_(torch.where(blendable[:, None, None], blended, self.points))
        self.duration.copy_(torch.where(blendable, rest, self.duration))
        self.elapsed.masked_fill_(blendable, 0.0)
        self.velocity.copy_(torch.where(blendable[:, None], velocity, self.velocity))

    def advance(self, dt: float) -> Tensor:
        """Advance time by `dt` (s); returns where feet changed (N,) bool."""
        self.elapsed += dt
        self.step_elapsed += dt
        changed = self.elapsed >= self.duration
        self._start_segment(changed, self.velocity, 1 - self.leg, LATE)
        return changed

    def now(self) -> tuple[Tensor, Tensor]:
        """Return the current joints and base, and their rates, (N, 22) each."""
        s = (self.elapsed / self.duration).clamp(0, 1)
        slopes = DEGREE * self.points.diff(dim=1) / self.duration[:, None, None]
        # Sums of products, because training may allow TF32 in matrix products.
        value = (self._bernstein(s, DEGREE) * self.points).sum(1)
        return value, (self._bernstein(s, DEGREE - 1) * slopes).sum(1)

    def _bernstein(self, s: Tensor, degree: int) -> Tensor:
        """Return the Bernstein weights (N, degree + 1, 1) of a Bezier curve at s (N,)."""
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
        """Return the control points of the curves (N, 8, C) restricted to [s, 1], s (N,)."""
        s = s[:, None, None]
        lasts = []
        for _ in range(DEGREE):  # de Casteljau
            lasts.append(points[..., -1:, :])
            points = torch.lerp(points[..., :-1, :], points[..., 1:, :], s)
        return torch.cat([points, *reversed(lasts)], -2)


def _cell(grid: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
    """Return each value's (N,) cell in an even grid and its position in the cell, 0 to 1."""
    spacing = (grid[-1] - grid[0]) / (len(grid) - 1)
    at = ((value - grid[0]) / spacing).clamp(0, len(grid) - 1)
    i = at.long().clamp(0, len(grid) - 2)  # keeps the index valid if the value is NaN
    return i, at - i
