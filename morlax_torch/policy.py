"""A trained family of policies, as other programs use it."""

import copy
import os
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from . import checkpoint
from .agent import Agent
from .config import Config, load_config
from .envs import MorlaxError, resolve_device
from .tradeoffs import checked_tradeoff, one_tradeoff

SHIPPED = Path(__file__).parent / "shipped"


class SpecializedPolicy(nn.Module):
    """The policy of one trade-off: observations (B, O) to actions (B, A) in (-1, 1)."""

    def __init__(self, normalizer: nn.Module, actor: nn.Module):
        super().__init__()
        self.normalizer, self.actor = normalizer, actor

    def forward(self, observation: Tensor) -> Tensor:
        mean, _ = self.actor(self.normalizer(observation)).chunk(2, dim=-1)
        return mean.tanh()


class Policy(nn.Module):
    """Every trade-off's deterministic policy.

    policy(observation, tradeoff): (B, O) and (m,) or (B, m) to actions (B, A) in (-1, 1); each row
    may have its own trade-off. Trade-offs need not sum to one, but not be negative or all zero.
    """

    def __init__(self, agent: Agent, config: Config, objectives: Sequence[str]):
        super().__init__()
        self.agent, self.config, self.objectives = agent, config, tuple(objectives)

    @torch.no_grad()
    def forward(self, observation: Tensor, tradeoff: Tensor | Sequence[float]) -> Tensor:
        tradeoff = checked_tradeoff(tradeoff, self.objectives, observation.device)
        if tradeoff.ndim == 2 and len(tradeoff) != len(observation):
            raise MorlaxError(
                f"there are {len(observation)} observations but {len(tradeoff)} trade-offs: give "
                "one for each, or one for all."
            )
        seen = self.agent.observation_normalizer(observation)
        if tradeoff.ndim == 1:
            output = self.agent.actor.run(self.agent.actor(tradeoff[None]), seen[None])[0]
        else:
            output = self.agent.actor.run(self.agent.actor(tradeoff), seen[:, None])[:, 0]
        mean, _ = output.chunk(2, dim=-1)
        return mean.tanh()

    def specialize(self, tradeoff: Tensor | Sequence[float]) -> SpecializedPolicy:
        """A plain module for one trade-off (m,), normaliser and tanh inside."""
        normalizer = copy.deepcopy(self.agent.observation_normalizer)
        tradeoff = one_tradeoff(tradeoff, self.objectives, normalizer.mean.device)
        fixed = SpecializedPolicy(normalizer, self.agent.actor.specialize(tradeoff))
        return fixed.requires_grad_(False)

    def save(self, path: Path) -> None:
        """Write what `load` needs and no more: without critic, optimiser and worlds."""
        state, own = self.agent.state_dict(), self.agent.own_networks()
        own.pop("critic", None)
        parts = ("actor.", "observation_normalizer.")
        contents = {
            "config": self.config.model_dump(mode="json"),
            "environment": {
                "objectives": list(self.objectives),
                "observation_size": self.agent.observation_size,
                "action_size": self.agent.action_size,
                "privileged_size": self.agent.privileged_size,
            },
            "own_networks": own,
            "policy": {name: value for name, value in state.items() if name.startswith(parts)},
        }
        checkpoint.write(path, contents)


def find_run(run: str | os.PathLike[str]) -> Path:
    """The folder of a run, given by its path, by a checkpoint of it, or by a shipped name."""
    path = Path(run)
    if path.is_file():
        return path.parent.parent if path.parent.name == "checkpoints" else path.parent
    if path.is_dir():
        return path
    shipped = {folder.name: folder for folder in SHIPPED.glob("*")}
    if str(run) in shipped:
        return shipped[str(run)]
    raise MorlaxError(
        f"{path} does not exist: name the folder of a run, such as runs/ant/..., a .pt, or a "
        f"policy that ships: {', '.join(sorted(shipped))}."
    )


def find_checkpoint(run: str | os.PathLike[str]) -> Path:
    """The best checkpoint of a run's folder or of a shipped policy, or the file itself."""
    if Path(run).is_file():
        return Path(run)
    folder = find_run(run)
    for name in ("best", "latest"):
        candidate = folder / "checkpoints" / f"{name}.pt"
        if candidate.is_file():
            return candidate
    raise MorlaxError(
        f"{folder} has no checkpoints: name the folder of a run, such as runs/ant/..., or a .pt."
    )


def load(
    run: str | os.PathLike[str],
    device: str | torch.device | None = "cpu",
    actor: nn.Module | None = None,
) -> Policy:
    """The policies of a run's folder, of a checkpoint file, or of a shipped name ("ant").

    A run with an actor of the user's own needs a module like it, whose parameters do not matter.

    Raises:
        MorlaxError: there is none, it is damaged, or has another actor.
    """
    place = resolve_device(device)
    path = find_checkpoint(run)
    contents = checkpoint.load(path, place)
    config, stored = load_config(contents["config"]), contents["environment"]
    agent = Agent(
        stored["observation_size"],
        stored["action_size"],
        len(stored["objectives"]),
        config.network,
        privileged_size=stored.get("privileged_size", 0),
        actor=actor,
    ).to(place)
    own = dict(contents.get("own_networks", {}))
    own_critic = own.pop("critic", None)
    checkpoint.check_networks(own, agent.own_networks(), path)
    state = contents["morlax"]["agent"] if "morlax" in contents else contents["policy"]
    if own_critic:  # no policy needs it
        state = {name: value for name, value in state.items() if not name.startswith("critic.")}
    agent.load_state_dict(state, strict="morlax" in contents and not own_critic)
    return Policy(agent, config, stored["objectives"])
