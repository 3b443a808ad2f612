"""A task for mjlab: the G1 walks while others move its arms, and punches hit it.

A policy owns legs and waist, the arms go to targets that walk at random, and in every segment of 5
s a random joint is hit from a random direction.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from mjlab.managers import (  # pyright: ignore[reportMissingImports]
    RewardTermCfg,
    SceneEntityCfg,
)
from mjlab.managers.action_manager import (  # pyright: ignore[reportMissingImports]
    ActionTerm,
    ActionTermCfg,
)
from mjlab.tasks import registry  # pyright: ignore[reportMissingImports]
from torch import Tensor

from ...worlds.episodes import refill
from . import tour_rules as rules

WALKING = "Mjlab-Velocity-Flat-Unitree-G1"
STEP = 0.2  # how much an episode that lasts raises the level
TURNING = 0.7  # share of commands that turn to a heading, as those of a tour do


@dataclass(kw_only=True)
class HarnessCfg(ActionTermCfg):
    curriculum: bool

    def build(self, env: Any) -> "Harness":
        return Harness(self, env)


class Harness(ActionTerm):
    """Moves the arms of N robots, and punches them; takes no action.

    Episodes begin in a random second of the tour: punches are as strong, times the level of their
    world, and arms move to where they may be by then in the first segment. With a curriculum,
    levels begin at 0, rise with each episode that lasts, and sink with one that ends in its first
    half; else they are 1.
    """

    action_dim = 0
    target_names: tuple[str, ...] = ()

    def __init__(self, cfg: HarnessCfg, env: Any):
        super().__init__(cfg, env)
        self._robot, model, N = env.scene[cfg.entity_name], env.sim.mj_model, env.num_envs
        joints = torch.tensor([self._robot.joint_names.index(name) for name in rules.ARMS])
        self._arms = joints.to(env.device)
        zeros = partial(torch.zeros, dtype=torch.float32, device=env.device)
        self._mirror = torch.tensor(rules.MIRROR, dtype=torch.float32, device=env.device)
        named = [model.joint(f"{cfg.entity_name}/{name}").id for name in self._robot.joint_names]
        self._joints = torch.tensor(named, device=env.device)
        self._bodies = torch.from_numpy(model.jnt_bodyid[named]).long().to(env.device)
        ranges = torch.from_numpy(model.jnt_range[named]).float()[joints[: len(rules.ARM)]]
        self._lowest, self._highest = ranges.to(env.device).T
        self._before = zeros(N, len(rules.ARM))  # rad, of the left arm
        self._after = torch.zeros_like(self._before)
        self._skipped = zeros(N)  # s of the tour before the episode
        self.level = zeros(N) + (not cfg.curriculum)
        self._hit = torch.zeros(N, dtype=torch.long, device=env.device)  # joint of the punch
        self._force = zeros(N, 3)
        self._targets = zeros(N, 2 * len(rules.ARM))
        self.reset(slice(None))

    @property
    def raw_action(self) -> Tensor:
        return self._force[:, :0]

    def reset(self, env_ids: Any) -> None:
        stance = self._robot.data.default_joint_pos[:, self._arms[: len(rules.ARM)]]
        skipped = torch.empty_like(self._skipped).uniform_(0, rules.RAMP)
        anywhere = torch.lerp(self._lowest, self._highest, torch.rand_like(stance))
        walked = torch.lerp(stance, anywhere, (skipped / rules.RAMP).sqrt()[:, None])
        self._before[env_ids], self._after[env_ids] = stance[env_ids], walked[env_ids]
        self._skipped[env_ids] = skipped[env_ids]
        if self.cfg.curriculum:
            steps, most = self._env.episode_length_buf, self._env.max_episode_length
            change = STEP * (steps >= most).float() - 0.5 * STEP * (steps < most / 2)
            self.level[env_ids] = (self.level + change).clamp(0, 1)[env_ids]

    def process_actions(self, actions: Tensor) -> None:
        steps, dt = self._env.episode_length_buf, self._env.step_dt
        segment, since = round(rules.SEGMENT / dt), steps - round(rules.DELAY / dt)
        self._move_arms(steps, round(rules.WINDOW / dt), segment)
        phase = since % segment
        self._aim((since >= 0) & (phase == 0), steps * dt)
        self._punch((since >= 0) & (phase < round(rules.DURATION / dt)))

    def apply_actions(self) -> None:
        self._robot.set_joint_position_target(self._targets, joint_ids=self._arms)

    def _move_arms(self, steps: Tensor, window: int, approach: int) -> None:
        """Draw a target every `window` steps, once the first has been reached, after `approach`."""
        shape = *self._after.shape, window
        walk = self._after.new_empty(shape).uniform_(-rules.WANDER, rules.WANDER).sum(-1)
        wish = (self._after + walk).clamp(self._lowest, self._highest)
        due = (steps % window == 0) & (steps >= approach)
        refill(due, self._after, self._before)
        refill(due, wish, self._after)
        share = torch.where(steps < approach, (steps + 1) / approach, (steps % window + 1) / window)
        left = torch.lerp(self._before, self._after, share[:, None])
        self._targets.copy_(torch.cat([left, left * self._mirror], 1))

    def _aim(self, due: Tensor, seconds: Tensor) -> None:
        """Draw joint, direction and force of a punch in the worlds of a mask (N,)."""
        joint = torch.empty_like(self._skipped).uniform_(0, len(self._joints)).long()
        direction = torch.nn.functional.normalize(torch.randn_like(self._force), dim=1)
        climbed = ((self._skipped + seconds) / rules.RAMP).clamp(max=1)
        share = self.level * torch.empty_like(climbed).uniform_(rules.LIGHTEST, 1)
        refill(due, joint.clamp(max=len(self._joints) - 1), self._hit)
        refill(due, direction * (rules.strongest(climbed) * share)[:, None], self._force)

    def _punch(self, active: Tensor) -> None:
        """Push at the joints that are hit, in the worlds of a mask (N,)."""
        data, worlds = self._env.sim.data, torch.arange(self.num_envs, device=self.device)
        body = self._bodies[self._hit]
        arm = data.xanchor[:][worlds, self._joints[self._hit]] - data.xipos[:][worlds, body]
        force = self._force * active[:, None]
        wrench = torch.cat([force, torch.linalg.cross(arm, force)], 1)
        applied = data.xfrc_applied[:]
        index = body[:, None, None].expand(-1, 1, 6)
        applied.copy_(torch.zeros_like(applied).scatter_(1, index, wrench[:, None]))


class Vibration:
    """The benchmark's vibration of a control step: changes of joints' accelerations in rad/s^2."""

    def __init__(self, cfg: Any, env: Any):
        self._robot = env.scene[cfg.params["asset_cfg"].name]
        self._speed = torch.zeros_like(self._robot.data.joint_vel)
        self._acceleration = torch.zeros_like(self._speed)

    def __call__(self, env: Any, asset_cfg: Any) -> Tensor:
        speed = self._robot.data.joint_vel
        acceleration = (speed - self._speed) / env.step_dt
        change = (acceleration - self._acceleration).abs().sum(1)
        self._speed.copy_(speed)
        self._acceleration.copy_(acceleration)
        return change

    def reset(self, env_ids: Any) -> None:
        self._speed[env_ids] = 0.0
        self._acceleration[env_ids] = 0.0


def config(play: bool) -> Any:
    """Return mjlab's config of the G1 that walks, with the harness and without pushes."""
    cfg = registry.load_env_cfg(WALKING, play)
    action, pose = cfg.actions["joint_pos"], cfg.rewards["pose"].params
    action.actuator_names, action.scale = rules.OWNED, _owned(action.scale)
    pose["asset_cfg"].joint_names = rules.OWNED
    articulation = cfg.scene.entities["robot"].articulation
    articulation.actuators = _limited(articulation.actuators)
    for name in ("std_standing", "std_walking", "std_running"):
        pose[name] = _owned(pose[name])
    cfg.actions["harness"] = HarnessCfg(entity_name="robot", curriculum=not play)
    cfg.events.pop("push_robot", None)
    cfg.curriculum = {}  # of faster commands
    twist = cfg.commands["twist"]
    twist.ranges.lin_vel_x, twist.ranges.lin_vel_y = (-0.6, 1.0), (-0.5, 0.5)
    twist.ranges.ang_vel_z = (-1.0, 1.0)
    twist.heading_control_stiffness, twist.rel_heading_envs = rules.GAIN, TURNING
    params = {"asset_cfg": SceneEntityCfg("robot")}
    cfg.rewards["vibration"] = RewardTermCfg(func=Vibration, weight=0.0, params=params)
    return cfg


def _owned(values: dict[str, float]) -> dict[str, float]:
    """Return the values whose names or patterns are not of arms."""
    arms = ("shoulder", "elbow", "wrist")
    return {name: value for name, value in values.items() if not any(x in name for x in arms)}


def _limited(actuators: Any) -> tuple[Any, ...]:
    """Return configs of actuators, one for each name, with the benchmark's torques."""
    return tuple(
        replace(
            actuator,
            target_names_expr=(name,),
            effort_limit=rules.TORQUE if rules.WEAKER in name else actuator.effort_limit,
        )
        for actuator in actuators
        for name in actuator.target_names_expr
    )


walking = registry.load_rl_cfg(WALKING), registry.load_runner_cls(WALKING)
registry.register_mjlab_task(rules.TASK, config(False), config(True), *walking)
