"""Compare a front on a velocity task of mjlab with the policy of mjlab's own training.

    python benchmarks/mjlab_front.py runs/mjlab:Mjlab-Velocity-Flat-Unitree-Go1/RUN --peer LOG

Every policy follows the same distribution of commands, in episodes that restart after a fall.
`error` is mjlab's metric `error_vel_xy`: the mean distance between the commanded and the actual
velocity. Candidates are chosen in one set of worlds and measured in another.
"""

import contextlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mjlab_peer
import torch
import tyro
from rich.table import Table
from torch import Tensor

from morlax_torch import envs, load
from morlax_torch.envs import Worlds, resolve_device
from morlax_torch.runs import checkpoint
from morlax_torch.runs.loading import find_checkpoint
from morlax_torch.terminal.cli import console
from morlax_torch.tradeoffs import evaluation_tradeoffs

LOUD = 100.0  # an action scale that bounds no action
SLOWEST = 0.3  # m/s; slower commands say little about walking
WALKS = 0.5  # share of the commanded speed that counts as walking
FALLS = 0.2  # per 1,000 steps, at most, of a policy that walks

Act = Callable[[Tensor], Tensor]  # (K, G, O) to (K, G, A), in mjlab's units


class Walks(NamedTuple):
    """Means over the worlds and steps of K policies, (K,) each."""

    error: Tensor  # m/s, of the velocity forward and to the left
    yaw: Tensor  # rad/s
    speed: Tensor  # along the command, as a share of the commanded
    power: Tensor  # W, positive mechanical power of all joints
    torque: Tensor  # (N m)², sum over the joints
    jerk: Tensor  # mean squared change of an action
    falls: Tensor  # per 1,000 steps


def main(
    run: tyro.conf.Positional[Path],
    peer: Path | None = None,
    tradeoffs: int = 64,
    worlds: int = 4096,
    steps: int = 1000,
    seed: int = 0,
    device: str | None = None,
) -> None:
    """Print how the best policies of a run walk.

    Args:
        run: Folder of the run.
        peer: Folder of mjlab's own training; without a checkpoint there, mjlab trains first, for
            as many environment steps as the run.
        tradeoffs: Number of trade-offs to choose from.
        worlds: Worlds to walk in.
        steps: Control steps of each.
        seed: Seed of the worlds and of mjlab's training.
        device: cuda or cpu (None: CUDA if available).
    """
    place = resolve_device(device)
    policy = load(run, place)
    name = policy.config.env
    options = policy.config.task.for_evaluation()
    scale = options.action_scale
    loud = options.model_copy(update={"action_scale": LOUD}).model_dump()

    def make(seed: int) -> Worlds:
        return envs.make(name, worlds, place, seed=seed, **loud)

    def actor(tradeoffs: Tensor) -> Act:
        actors = policy.agent.actors(tradeoffs.to(place))
        return lambda seen: actors.act(seen) * scale

    points = evaluation_tradeoffs(tradeoffs, len(policy.objectives))
    tried = walk(make(2 * seed), actor(points), tradeoffs, steps)
    walking = (tried.speed > WALKS) & (tried.falls < FALLS)
    chosen = {"best tracking": tried.error.argmin()}
    if walking.any():
        chosen["least power, walking"] = torch.where(walking, tried.power, torch.inf).argmin()
    picked = points[torch.stack(list(chosen.values())).cpu()]
    found = walk(make(2 * seed + 1), actor(picked), len(chosen), steps)
    rows = {label: [value[i] for value in found] for i, label in enumerate(chosen)}
    if peer is not None:
        task = name.removeprefix("mjlab:").rpartition(":")[2]
        total = checkpoint.load(find_checkpoint(run)).progress.env_steps
        theirs = _peer(task, peer, total, policy.config.worlds, str(place), seed)
        rows["mjlab's own training"] = [
            value[0] for value in walk(make(2 * seed + 1), theirs, 1, steps)
        ]
    table = Table("", "trade-off", *Walks._fields, title=f"{name}, {len(points)} trade-offs")
    for i, (label, values) in enumerate(rows.items()):
        weights = " ".join(f"{w:.2f}" for w in picked[i].tolist()) if i < len(picked) else ""
        table.add_row(label, weights, *(f"{float(v):.3g}" for v in values))
    console.print(table)


@torch.no_grad()
def walk(env: Worlds, act: Act, policies: int, steps: int) -> Walks:
    """Let K policies walk, each in its share of the worlds.

    Args:
        env: N worlds of `MjlabWorlds`, of which K clusters are used.
        act: from observations (K, G, O) to actions.
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


def _peer(task: str, log: Path, steps: int, worlds: int, device: str, seed: int) -> Act:
    """Load mjlab's own policy, or train it first for `steps`."""
    files = sorted(log.glob("model_*.pt"), key=lambda file: file.stat().st_mtime)
    number = worlds if not files else 16
    runner = mjlab_peer.runner(task, number, device, seed, log)
    if files:
        runner.load(str(files[-1]), map_location=device)
    else:
        iterations = max(1, round(steps / worlds / runner.cfg["num_steps_per_env"]))
        with contextlib.redirect_stdout(io.StringIO()):
            runner.learn(iterations, init_at_random_ep_len=True)
    policy = runner.get_inference_policy(device)
    return lambda seen: policy({"actor": seen[0]})[None]


if __name__ == "__main__":
    tyro.cli(main)
