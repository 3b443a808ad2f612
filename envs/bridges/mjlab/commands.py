"""mjlab's commands, drawn in every world where a mask is true: what `MaskedStep` needs of them."""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ...worlds.episodes import refill
from .motion import bounds

EVEN = 0.5  # share of episodes that start anywhere in a motion
VELOCITY, MOTION = "UniformVelocityCommand", "MotionCommand"  # mjlab's classes
NEVER = 1e6  # s; a motion that is drawn so rarely changes only at its end and with an episode

Masked = Callable[[str, Tensor, Callable[[], None]], None]


class Velocity:
    """A velocity to walk with."""

    def __init__(self, term: Any, masked: Masked):
        self._term = term

    @staticmethod
    def supports(cfg: Any) -> bool:
        return not cfg.init_velocity_prob

    def restart(self, mask: Tensor) -> None:
        """Draw new commands in the worlds of a mask (N,)."""
        term, cfg, ranges = self._term, self._term.cfg, self._term.cfg.ranges

        def uniform(low: float, high: float) -> Tensor:
            return torch.empty_like(term.time_left).uniform_(low, high)

        refill(mask, uniform(*cfg.resampling_time_range), term.time_left)
        each = (ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z)
        wish = torch.stack([uniform(*limits) for limits in each], 1)
        if cfg.heading_command:
            refill(mask, uniform(*ranges.heading), term.heading_target)
            refill(mask, uniform(0, 1) <= cfg.rel_heading_envs, term.is_heading_env)
        refill(mask, uniform(0, 1) <= cfg.rel_standing_envs, term.is_standing_env)
        refill(mask, uniform(0, 1) <= cfg.rel_world_envs, term.is_world_env)
        refill(mask, uniform(0, 1) <= cfg.rel_forward_envs, term.is_forward_env)
        refill(mask, wish, term.vel_command_w)
        ahead = torch.zeros_like(wish)
        ahead[:, 0] = wish[:, 0].abs().clamp(min=0.3)
        refill(mask, torch.where(term.is_forward_env[:, None], ahead, wish), term.vel_command_b)

    def go_on(self) -> None:
        """Leave the robots as they are, as a velocity does within an episode."""

    def pass_time(self, dt: Tensor) -> None:
        """Let time pass, (N,) seconds: draw new commands, and turn those to a heading."""
        term, cfg, command = self._term, self._term.cfg, self._term.vel_command_b
        term.time_left -= dt
        self.restart(term.time_left <= 0)
        heading = term.robot.data.heading_w
        if cfg.heading_command:
            error = term.heading_target - heading
            term.heading_error = torch.atan2(error.sin(), error.cos())
            turn = (cfg.heading_control_stiffness * term.heading_error).clamp(*cfg.ranges.ang_vel_z)
            refill(term.is_heading_env, turn, command[:, 2])
        x, y = term.vel_command_w[:, :2].unbind(1)
        cos, sin = heading.cos(), heading.sin()
        turned = torch.stack([cos * x + sin * y, cos * y - sin * x], 1)
        refill(term.is_world_env, turned, command[:, :2])
        for velocity in (command, term.vel_command_w):
            velocity.masked_fill_(term.is_standing_env[:, None], 0.0)


class Motion:
    """Motions to follow. Half of the episodes start where robots failed, the others anywhere.

    In thousands of worlds, mjlab's share of even draws vanishes beside its counts of failures, and
    hardly an episode starts in a second in which nobody fails, such as the first.
    """

    def __init__(self, term: Any, masked: Masked):
        self._term, self._masked = term, masked
        self._everyone = torch.arange(term.num_envs, device=term.device)
        frames = bounds(term.cfg.motion_file)
        # whether a motion ends before a frame
        self._borders = torch.zeros(frames[-1] + 1, dtype=torch.bool, device=term.device)
        self._borders[frames[1:]] = True
        term._adaptive_sampling = self._draw_frames  # mjlab's counts failures there, too

    @staticmethod
    def supports(cfg: Any) -> bool:
        return cfg.resampling_time_range[0] > NEVER

    def restart(self, over: Tensor) -> None:
        """Go on by a frame; put robots at new ones where an episode (N,) or a motion is over."""
        term, total = self._term, self._term.motion.time_step_total
        failed = term._env.termination_manager.terminated & over
        bins = term.time_steps * term.bin_count // total
        counts = torch.zeros_like(term.bin_failed_count).index_add_(0, bins, failed.float())
        last_counts = term._current_bin_failed
        last_counts.copy_(torch.where(failed.any(), counts, last_counts))
        term.time_steps += 1
        ended = self._borders[term.time_steps] & ~over
        resample = partial(term._resample_command, self._everyone)
        self._masked("motion", over | ended, resample)
        # mjlab moves on after drawing
        term.time_steps.add_(over & ~self._borders[term.time_steps + 1])
        term._pending_forward = False  # the step computes positions of bodies anyway

    def go_on(self) -> None:
        """Go on by a frame within an episode, and to a new one after the last."""
        self.restart(torch.zeros_like(self._term.time_steps, dtype=torch.bool))

    def _draw_frames(self, worlds: Tensor) -> None:
        """Draw frames for some worlds (n,): half evenly, half with mjlab's chances of a second."""
        term = self._term
        size, total = term.cfg.adaptive_kernel_size, term.bin_count
        weights = term.bin_failed_count + term.cfg.adaptive_uniform_ratio / total
        later = weights[-1:].expand(size - 1)
        weights = (torch.cat([weights, later]).unfold(0, size, 1) * term.kernel).sum(1)
        shares = (1 - EVEN) * weights / weights.sum() + EVEN / total
        quantiles, within = weights.new_empty(len(worlds), 2).uniform_().unbind(1)
        bins = torch.searchsorted(shares.cumsum(0), quantiles.contiguous()).clamp(max=total - 1)
        frames = (bins + within) / total * (term.motion.time_step_total - 1)
        term.time_steps[worlds] = frames.long()

    def pass_time(self, dt: Tensor) -> None:
        """Move the motion to where the robots are, and remember where they failed."""
        term, rate = self._term, self._term.cfg.adaptive_alpha
        term.update_relative_body_poses()
        if term.cfg.sampling_mode == "adaptive":
            term.bin_failed_count.mul_(1 - rate).add_(rate * term._current_bin_failed)
            term._current_bin_failed.zero_()


COMMANDS: dict[str, type[Velocity] | type[Motion]] = {VELOCITY: Velocity, MOTION: Motion}
