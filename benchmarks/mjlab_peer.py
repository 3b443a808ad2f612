"""Train with mjlab's own runner, rsl_rl, to compare with.

    python benchmarks/mjlab_peer.py go1.pt --weighting effort --seconds 300

The file keeps the state of training, so the command goes on where it ended, even if it was killed.
With --task Pareto-Velocity-Flat-Unitree-Go1, ParetoPPO trains a front, whose file is a run.
"""

import contextlib
import importlib
import io
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import torch
import tyro
import yaml
from torch import Tensor

from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.config import Config
from morlax_torch.envs import MorlaxError, Worlds, resolve_device
from morlax_torch.envs.bridges.mjlab.config import MjlabOptions, add_terms
from morlax_torch.envs.bridges.mjlab.history import UNMEASURED
from morlax_torch.envs.bridges.mjlab.motion import prepared

LOUD = 100.0  # an action scale that bounds no action
WEIGHTINGS = Path(__file__).with_name("mjlab_weightings.yaml")
CHUNK = 10  # iterations between checkpoints


class Peer(NamedTuple):
    """A policy of rsl_rl in the place of an `Agent` and its `Actors`, for every trade-off."""

    policy: Callable[[dict[str, Tensor]], Tensor]
    objectives: tuple[str, ...]  # of the task in which it acts
    sensors: str = "all"  # that it was trained with
    parameters: dict[str, Tensor] = {}

    @property
    def task(self) -> dict[str, Any]:
        """Options of the task in which it acts as it was trained."""
        return {"action_scale": LOUD, "sensors": self.sensors, "history": {}}

    def check_sizes(self, env: Worlds) -> None:
        pass  # rsl_rl built the policy for this task

    def actors(self, tradeoffs: Tensor) -> Self:
        return self

    def copy_(self, other: Self, rows: slice = slice(None)) -> None:
        pass

    def act(self, observation: Tensor) -> Tensor:
        """Return actions (K, 1, A) of worlds whose action scale is LOUD."""
        return self.policy({"actor": observation[:, 0]})[:, None] / LOUD


def main(
    file: tyro.conf.Positional[Path],
    task: str = "Mjlab-Velocity-Flat-Unitree-Go1",
    weighting: str = "default",
    weightings: Path = WEIGHTINGS,
    worlds: int = 4096,
    steps: int = 2**62,
    seconds: float = 300.0,
    seed: int = 0,
    device: str | None = None,
    motion: Path | None = None,
    sensors: Literal["all", "real"] = "all",
) -> None:
    """Train a policy, or go on with one, until the first of two limits.

    Args:
        file: Checkpoint to write.
        task: Name in mjlab's registry.
        weighting: Name of reward weights.
        weightings: YAML file of weightings, by task and name.
        worlds: Number of worlds; mjlab's own default is 4,096.
        steps: Environment steps in all.
        seconds: Training time of this call, in seconds.
        seed: Seed of training.
        device: cuda or cpu (None: CUDA if available).
        motion: Motion of a tracking task, in mjlab's npz format.
        sensors: What the policy observes: all terms, or those that a robot's sensors measure.
    """
    plain = task.replace("Pareto", "Mjlab", 1)
    weights = yaml.safe_load(weightings.read_text())[plain][weighting]
    target = str(resolve_device(device))
    runner = make_runner(task, worlds, target, seed, weights, motion, sensors)
    per_iteration = worlds * runner.cfg["num_steps_per_env"]
    done = runner.load(str(file))["env_steps"] if file.exists() else 0
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    # without the ONNX file that a velocity runner writes each time
    save = importlib.import_module("mjlab.rl").MjlabOnPolicyRunner.save
    start, first, passed = time.perf_counter(), done, 0.0
    while done < steps and passed < seconds:
        number = min(CHUNK, math.ceil((steps - done) / per_iteration))
        with contextlib.redirect_stdout(io.StringIO()):
            runner.learn(number, init_at_random_ep_len=done == first)
        done += number * per_iteration
        save(runner, str(part), {"env_steps": done, "sensors": sensors})
        part.replace(file)
        passed = time.perf_counter() - start
        env = runner.env.unwrapped
        share = env.termination_manager.terminated.float().mean()
        console.print(
            f"{task}, {weighting}, seed {seed}: {done / 1e6:.1f} M steps, "
            f"{passed:.0f} s, {(done - first) / passed:,.0f} steps/s, "
            f"{share:.2%} of worlds failed in the last step, whose mean reward was "
            f"{env.reward_buf.mean():.4f}, rate {runner.alg.learning_rate:.1e}"
        )


def load_peer(config: Config, file: Path) -> Peer:
    """Load the policy of a file that `main` wrote, for the task and device of a run's config.

    Raises:
        MorlaxError: there is no such file.
    """
    if not file.exists():
        raise MorlaxError(f"{file} is missing: train it with benchmarks/mjlab_peer.py.")
    infos = torch.load(file, map_location="cpu", weights_only=False)["infos"]
    sensors = infos.get("sensors", "all")
    task, device = config.env.rpartition(":")[2], str(resolve_device(config.device))
    motion = Path(config.task.motion_file) if config.task.motion_file else None
    runner = make_runner(task, 16, device, motion=motion, sensors=sensors)
    runner.load(str(file), {"actor": True}, map_location=device)
    return Peer(runner.get_inference_policy(device), (*config.task.objectives,), sensors)


def make_runner(
    task: str,
    worlds: int,
    device: str,
    seed: int = 0,
    weights: dict[str, float] | None = None,
    motion: Path | None = None,
    sensors: str = "all",
) -> Any:
    """Return mjlab's runner of one of its tasks, as its command `train` builds it.

    It writes no files. `weights` are factors on those of rewards, see mjlab_weightings.yaml.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        importlib.import_module("mjlab.tasks")
        registry = importlib.import_module("mjlab.tasks.registry")
        wrappers = importlib.import_module("mjlab.rl")
        importlib.import_module("mjlab.utils.torch").configure_torch_backends()
        cfg, agent = registry.load_env_cfg(task), registry.load_rl_cfg(task)
        cfg.scene.num_envs, cfg.seed, agent.seed = worlds, seed, seed
        add_terms(cfg)
        for term in UNMEASURED if sensors == "real" else ():
            cfg.observations["actor"].terms.pop(term, None)
        for term, factor in (weights or {}).items():
            cfg.rewards[term].weight = factor * (cfg.rewards[term].weight or 1.0)
        if motion is not None:  # as fast as in our worlds, with their stand
            robot, rate = cfg.scene.entities["robot"].spec_fn, 50.0
            options = MjlabOptions.model_fields
            fps, stand = options["motion_fps"].default, options["motion_stand"].default
            cfg.commands["motion"].motion_file = str(
                prepared(motion, 0, fps, stand, rate, robot)[0]
            )
        agent.logger = "tensorboard"
        torch.manual_seed(seed)
        env = importlib.import_module("mjlab.envs").ManagerBasedRlEnv(cfg, device=device)
        wrapped = wrappers.RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions)
        kind = registry.load_runner_cls(task) or wrappers.MjlabOnPolicyRunner
        return kind(wrapped, asdict(agent), None, device)


if __name__ == "__main__":
    tyro.cli(main)
