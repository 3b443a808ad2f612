"""What each of the processes of a run has after training, for test_group.py."""

from pathlib import Path
from typing import Any

import torch
from tiny import tiny

from morlax_torch import MorlaxError
from morlax_torch.algorithms.batch import make_batch
from morlax_torch.algorithms.registry import make_learner
from morlax_torch.algorithms.rollout import Rollout
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.sections import HyperSACOptions
from morlax_torch.gpu.group import ALONE, Group, join
from morlax_torch.runs import checkpoint
from morlax_torch.runs.loading import start_from
from morlax_torch.runs.progress import Progress

WORLDS, HORIZON, CLUSTERS = 32, 4, 4
ITERATIONS = 2


def config(algorithm: str, size: int) -> Config:
    """Return the config of one of `size` processes."""
    changes = {"ppo.desired_kl": 0.01, "task.reset_noise": 0.05, "max_env_steps": 100_000}
    if algorithm == "hyper-sac":
        changes |= {"method.batch": 32, "method.updates": 2}
    return tiny(algorithm=algorithm, worlds=WORLDS // size, horizon=HORIZON, **changes)


def statistics(group: Group) -> dict[str, Any]:
    """Return what a learner makes of this process's half of a random rollout."""
    own = config("morlax", group.size)
    learner = make_learner(own.make_worlds(own.worlds, 0), own, group=group)
    generator, share = torch.Generator().manual_seed(0), slice(group.rank, None, group.size)

    def drawn(part: torch.Tensor) -> torch.Tensor:
        shape = HORIZON, CLUSTERS, WORLDS // CLUSTERS, *part.shape[3:]
        noise = (3 + torch.randn(shape, generator=generator))[:, :, share].contiguous()
        return noise if part.is_floating_point() else noise > 4

    rollout = Rollout(*map(drawn, learner.rollout))
    learner.tradeoffs.copy_(torch.rand(learner.tradeoffs.shape, generator=generator))
    batch, _ = make_batch(
        learner.agent, learner.tradeoffs, rollout, own.ppo, learner.tradeoffs, group
    )
    learner.agent.observation_normalizer.update(rollout.observation, group=group)
    return {
        "observation": learner.agent.observation_normalizer.state_dict(),
        "value": learner.agent.value_normalizer.state_dict(),
        "advantage": batch.advantage,
    }


class Shifted(torch.nn.Module):
    """A network with a buffer, both drawn from torch's global generator."""

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        self.linear = torch.nn.Linear(inputs, outputs)
        self.register_buffer("shift", torch.rand(outputs))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.linear(x) + self.shift


def trained(algorithm: str, group: Group, **networks: torch.nn.Module) -> dict[str, Any]:
    """Return a learner's state after some iterations."""
    own = config(algorithm, group.size)
    learner = make_learner(own.make_worlds(own.worlds, 0), own, group=group, **networks)
    for _ in range(ITERATIONS):
        learner.iterate()
    return {**learner.state_dict(), "metrics": learner.metrics(), "steps": learner.env_steps}


def with_own_networks(algorithm: str, group: Group) -> dict[str, Any]:
    """Return the state of a learner with networks of this process."""
    torch.manual_seed(group.rank)
    inputs = 13 + 2 * (algorithm == "amor")  # whose networks see the trade-off too
    networks = {"actor": Shifted(inputs, 8), "critic": Shifted(inputs, 2)}
    if algorithm == "hyper-sac":  # which has its own critics
        del networks["critic"]
    return {**trained(algorithm, group, **networks), "shift": networks["actor"].shift}


def started(group: Group, folder: Path) -> dict[str, Any]:
    """Return an agent that starts from another file in every process."""
    own = config("morlax", group.size)
    env = own.make_worlds(own.worlds, 0)
    path = folder / f"start-{group.rank}.pt"
    other = own.model_copy(update={"seed": 1 + group.rank})
    checkpoint.write(path, checkpoint.snapshot(make_learner(env, other)), Progress())
    learner = make_learner(env, own, group=group)
    start_from(str(path), learner)
    return learner.agent.state_dict()


def refusal(group: Group) -> str:
    """Return what is said of networks of other sizes in every process."""
    own, hidden = config("morlax", group.size), 8 + group.rank
    actor = torch.nn.Sequential(Shifted(13, hidden), Shifted(hidden, 8))
    env = own.make_worlds(own.worlds, 0)
    try:
        make_learner(env, own, actor=actor, group=group)
    except MorlaxError as error:
        return str(error)
    return ""


def main(folder: str, *algorithms: str) -> None:
    HyperSACOptions.start = 1  # of this process: others import this module
    torch.distributed.init_process_group("gloo")  # as a user's program may have done
    _, group = join("cpu", "settings")
    assert join("cpu", "settings")[1] is group
    found = {name: trained(name, group) for name in algorithms}
    found["statistics"] = statistics(group)
    found["own"] = {name: with_own_networks(name, group) for name in algorithms}
    found["started"] = started(group, Path(folder))
    found["refusal"] = refusal(group)
    torch.save(found, Path(folder) / f"{group.rank}.pt")
    assert group is not ALONE
    torch.distributed.destroy_process_group()
