"""How policies walk in the velocity tasks of mjlab.

Every policy follows the same distribution of commands, in episodes that restart after a fall.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from morlax_torch import envs
from morlax_torch.configuration.tradeoffs import evaluation_tradeoffs
from morlax_torch.envs import Worlds
from morlax_torch.networks.policy import Policy

LOUD = 100.0  # an action scale that bounds no action
SLOWEST = 0.3  # m/s; slower commands say little about walking
WALKS = 0.5  # share of the commanded speed that counts as walking
FALLS = 0.2  # per 1,000 steps, at most, of a policy that walks

Act = Callable[[Tensor], Tensor]  # (K, G, O) to (K, G, A), in mjlab's units


class Walks(NamedTuple):
    """Means over the worlds and steps of K policies, (K,) each."""

    error: Tensor  # m/s, between commanded and actual velocity: mjlab's metric error_vel_xy
    yaw: Tensor  # rad/s, likewise
    speed: Tensor  # along the command, as a share of the commanded
    power: Tensor  # W, positive mechanical power of all joints
    torque: Tensor  # (N m)², sum over the joints
    jerk: Tensor  # mean squared change of an action
    falls: Tensor  # per 1,000 steps


class Found(NamedTuple):
    """One policy."""

    label: str
    tradeoff: list[float]
    walks: Walks  # of numbers


def make(policy: Policy, worlds: int, seed: int) -> Worlds:
    """Return worlds of the policy's task that take actions in mjlab's units, divided by LOUD."""
    options = policy.config.task.for_evaluation().model_dump() | {"action_scale": LOUD}
    device = policy.agent.observation_normalizer.mean.device
    return envs.make(policy.config.env, worlds, device, seed=seed, **options)


def best(policy: Policy, tradeoffs: int, worlds: int, steps: int, seed: int) -> list[Found]:
    """Find the policies that track best, and that walk with least power if any walks.

    They are chosen in one set of worlds, and measured in another.
    """
    points = evaluation_tradeoffs(tradeoffs, len(policy.objectives))
    tried = walk(make(policy, worlds, 2 * seed), _acting(policy, points), tradeoffs, steps)
    walking = (tried.speed > WALKS) & (tried.falls < FALLS)
    chosen = {"best tracking": tried.error.argmin()}
    if walking.any():
        chosen["least power, walking"] = torch.where(walking, tried.power, torch.inf).argmin()
    picked = points[torch.stack(list(chosen.values())).cpu()]
    walks = walk(make(policy, worlds, 2 * seed + 1), _acting(policy, picked), len(picked), steps)
    return [
        Found(label, weights, Walks(*(value[i] for value in walks)))
        for i, (label, weights) in enumerate(zip(chosen, picked.tolist(), strict=True))
    ]


@torch.no_grad()
def walk(env: Worlds, act: Act, policies: int, steps: int) -> Walks:
    """Let K policies walk, each in its share of the worlds.

    Args:
        env: N worlds that `make` returned.
        act: from observations (K, G, O) to actions (K, G, A).
        policies: K.
        steps: control steps.
    """
    robot, command = env.env.scene["robot"], env.env.command_manager
    used = env.num_worlds // policies * policies
    sums = [torch.zeros(used, device=env.device) for _ in range(len(Walks._fields) + 1)]
    seen, before = env.reset(), 0.0
    for _ in range(steps):
        wish = command.get_command("twist")[:used].clone()
        action = torch.zeros(env.num_worlds, env.action_size, device=env.device)
        action[:used] = act(seen[:used].view(policies, -1, seen.shape[1])).flatten(0, 1)
        step = env.step(action / LOUD)
        data = robot.data
        torque, turning = data.qfrc_actuator[:used], data.joint_vel[:used]
        made, turned = data.root_link_lin_vel_b[:used, :2], data.root_link_ang_vel_b[:used, 2]
        speed = wish[:, :2].norm(dim=1)
        fast = speed > SLOWEST
        values = (
            (wish[:, :2] - made).norm(dim=1),
            (wish[:, 2] - turned).abs(),
            torch.where(fast, (made * wish[:, :2]).sum(1) / speed, 0.0),
            torch.where(fast, speed, 0.0),
            (torque * turning).clamp(min=0).sum(1),
            torque.square().sum(1),
            (action[:used] - before).square().mean(1),
            step.terminated[:used].float(),
        )
        for total, value in zip(sums, values, strict=True):
            total += value.nan_to_num()
        seen, before = step.observation, action[:used]
    error, yaw, along, asked, power, torque, jerk, falls = (
        value.view(policies, -1).mean(1) / steps for value in sums
    )
    return Walks(error, yaw, along / asked, power, torque, jerk, 1000 * falls)


def _acting(policy: Policy, tradeoffs: Tensor) -> Act:
    device = policy.agent.observation_normalizer.mean.device
    actors, scale = policy.agent.actors(tradeoffs.to(device)), policy.config.task.action_scale
    return lambda seen: actors.act(seen) * scale
