"""TorchRL's PPO trains one family of policies: one policy per trade-off.

python docs/examples/torchrl_family.py --task hopper

Each episode draws a trade-off. Prints the returns of a few policies before and after training.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
import tyro
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import Unbounded
from torchrl.envs import ExplorationType, TensorDictPrimer, TransformedEnv, set_exploration_type
from torchrl.modules import MLP, NormalParamExtractor, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from morlax_torch import Hypernetwork
from morlax_torch.adapters.torchrl import TorchRLEnv


@dataclass
class Options:
    task: str = "hopper"  # name of a task
    device: str = "cuda" if torch.cuda.is_available() else "cpu"  # device of worlds and networks
    iterations: int = 40  # batches to learn from, of 50 control steps in each world
    num_envs: int = 64  # number of parallel worlds
    episode_length: int = 100  # control steps after which an episode is truncated
    seed: int = 0  # random seed of networks, trade-offs and actions


class Generated(nn.Module):
    """A hypernetwork and, for each row of trade-offs (..., m), the network that it generates.

    Maps observations (..., O) to outputs (..., D).
    """

    def __init__(self, num_objectives: int, observation_size: int, outputs: int):
        super().__init__()
        network = MLP(observation_size, outputs, num_cells=[32, 32], activation_class=nn.Tanh)
        nn.init.zeros_(network[-1].weight)  # policies start with the middle action
        nn.init.zeros_(network[-1].bias)
        self.family = Hypernetwork(network, num_objectives)

    def forward(self, tradeoffs: Tensor, observations: Tensor) -> Tensor:
        # a row may also be a batch: trade-offs (K, m) go with observations (K, B, O)
        parameters = self.family(tradeoffs.flatten(0, -2))  # name -> (rows, ...)
        outputs = self.family.run(parameters, observations.flatten(0, -2)[:, None])  # (rows, 1, D)
        return outputs.view(*observations.shape[:-1], -1)


def with_tradeoffs(env: TorchRLEnv, draw: Callable[[], Tensor]) -> TransformedEnv:
    """Return the worlds with an entry "tradeoff" (N, m), drawn at the start of each episode."""
    spec = {"tradeoff": Unbounded(len(env.objectives), device=env.device)}
    return TransformedEnv(env, TensorDictPrimer(spec, default_value=draw, expand_specs=True))


@torch.no_grad()
def evaluate(env: TorchRLEnv, actor: nn.Module, tradeoffs: Tensor) -> Tensor:
    """Return the returns (N, m) of trade-offs (N, m), one episode each without exploration."""
    worlds, length = with_tradeoffs(env, lambda: tradeoffs), env.worlds.episode_length
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        steps = worlds.rollout(length, actor, break_when_any_done=False)["next"]
    ended = steps["done"].int()
    return (steps["reward"] * (ended.cumsum(1) == ended)).sum(1)  # of the first episode


def train(options: Options) -> tuple[Tensor, Tensor]:
    """Train a family; returns the returns (m + 1, m) of corners and balance before and after."""
    torch.manual_seed(options.seed)
    N, length = options.num_envs, options.episode_length
    base = TorchRLEnv(options.task, N, options.device, episode_length=length)
    m, O, A = len(base.objectives), base.worlds.observation_size, base.worlds.action_size
    dirichlet = torch.distributions.Dirichlet(torch.ones(m, device=base.device))
    env = with_tradeoffs(base, lambda: dirichlet.sample((N,)))

    inputs = ["tradeoff", "observation"]
    networks = TensorDictSequential(
        TensorDictModule(Generated(m, O, 2 * A), inputs, ["outputs"]),
        TensorDictModule(NormalParamExtractor(), ["outputs"], ["loc", "scale"]),
    )
    distribution = {"distribution_class": TanhNormal, "return_log_prob": True}
    actor = ProbabilisticActor(networks, ["loc", "scale"], **distribution).to(env.device)
    critic = TensorDictModule(Generated(m, O, m), inputs, ["state_value"]).to(env.device)
    estimate = GAE(gamma=0.97, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(actor, critic, entropy_bonus=False, normalize_advantage=True)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)

    tradeoffs = torch.cat([torch.eye(m), torch.full((1, m), 1 / m)]).to(env.device)
    test_env = TorchRLEnv(options.task, m + 1, options.device, episode_length=length)
    before = evaluate(test_env, actor, tradeoffs)
    frames = {"frames_per_batch": 50 * N, "total_frames": 50 * N * options.iterations}
    for batch in Collector(env, actor, **frames, auto_register_policy_transforms=True):
        for flag in ("done", "terminated"):  # GAE requires one per objective
            batch["next", flag] = batch["next", flag].expand_as(batch["next", "reward"])
        estimate(batch)  # advantages (N, T, m)
        batch["advantage"] = (batch["advantage"] * batch["tradeoff"]).sum(-1, keepdim=True)
        for _ in range(4):
            for rows in batch.reshape(-1)[torch.randperm(batch.numel())].chunk(4):
                losses = loss(rows)
                optimizer.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimizer.step()
    after = evaluate(test_env, actor, tradeoffs)
    for tradeoff, old, new in zip(tradeoffs.tolist(), before.int(), after.int(), strict=True):
        print(f"{base.objectives} under {tradeoff}: {old.tolist()} -> {new.tolist()}")
    return before, after


if __name__ == "__main__":
    train(tyro.cli(Options, description=__doc__))
