"""skrl's PPO trains one family of policies: one policy per trade-off.

python docs/examples/skrl_family.py --task hopper

Each episode draws a trade-off. Prints the returns of a few policies before and after training.
"""

from dataclasses import dataclass

import torch
import tyro
from gymnasium.spaces import Box
from skrl.agents.torch.ppo import PPO
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from torch import Tensor, nn

from morlax_torch import Hypernetwork, envs
from morlax_torch.adapters.skrl import SkrlEnv


@dataclass
class Options:
    task: str = "hopper"  # name of a task
    device: str = "cuda" if torch.cuda.is_available() else "cpu"  # device of worlds and networks
    iterations: int = 40  # rollouts to learn from, of 50 control steps in each world
    num_envs: int = 64  # number of parallel worlds
    episode_length: int = 100  # control steps after which an episode is truncated
    seed: int = 0  # random seed of networks, trade-offs and actions


class TradeoffEnv(SkrlEnv):
    """Worlds that draw a trade-off (N, m) for each episode and show it as skrl's state."""

    def __init__(self, options: Options, num_envs: int):
        weights = [1.0] * len(envs.get(options.task).Options().objectives)
        changes = {"seed": options.seed, "episode_length": options.episode_length}
        super().__init__(options.task, weights, num_envs, options.device, **changes)
        self.dirichlet = torch.distributions.Dirichlet(torch.tensor(weights, device=self.device))
        self.tradeoffs = self.dirichlet.sample((num_envs,))

    @property
    def state_space(self) -> Box:
        return Box(0.0, 1.0, self.dirichlet.event_shape)

    def state(self) -> Tensor:
        return self.tradeoffs

    def step(self, actions: Tensor) -> tuple:
        observation, _, failed, truncated, info = super().step(actions)
        reward = (info["vector_reward"] * self.tradeoffs).sum(-1, keepdim=True)
        over = failed | truncated  # no bootstrapping: the next episode has another trade-off
        self.tradeoffs = torch.where(over, self.dirichlet.sample(over.shape[:1]), self.tradeoffs)
        return observation, reward, over, torch.zeros_like(over), info


class Family(GaussianMixin, DeterministicMixin, Model):
    """Two hypernetworks, which generate an actor and a critic for the trade-off of each row."""

    def __init__(self, **spaces: object):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        DeterministicMixin.__init__(self)
        self.log_std = nn.Parameter(torch.zeros(self.num_actions))
        self.families = nn.ModuleDict()
        for role, size in (("policy", self.num_actions), ("value", 1)):
            layers = nn.Linear(self.num_observations, 64), nn.Tanh(), nn.Linear(64, size)
            nn.init.zeros_(layers[-1].weight)  # policies start with the middle action
            nn.init.zeros_(layers[-1].bias)
            self.families[role] = Hypernetwork(nn.Sequential(*layers), self.num_states)

    def compute(self, inputs: dict[str, Tensor], role: str) -> tuple[Tensor, dict[str, Tensor]]:
        parameters = self.families[role](inputs["states"])  # name -> (B, ...)
        outputs = self.families[role].run(parameters, inputs["observations"][:, None])  # (B, 1, D)
        return outputs[:, 0], {"log_std": self.log_std}

    def act(self, inputs: dict[str, Tensor], *, role: str) -> tuple[Tensor, dict[str, Tensor]]:
        mixin = GaussianMixin if role == "policy" else DeterministicMixin
        return mixin.act(self, inputs, role=role)


@torch.no_grad()
def evaluate(options: Options, agent: PPO, tradeoffs: Tensor) -> Tensor:
    """Return the returns (N, m) of trade-offs (N, m), one episode each without exploration."""
    env = TradeoffEnv(options, len(tradeoffs))
    observation, alive, returns = env.reset()[0], 1.0, torch.zeros_like(tradeoffs)
    for step in range(options.episode_length):
        outputs = agent.act(observation, tradeoffs, timestep=step, timesteps=step)[1]
        observation, _, over, _, info = env.step(outputs["mean_actions"])
        returns += alive * info["vector_reward"]
        alive = alive * ~over
    return returns


def train(options: Options) -> tuple[Tensor, Tensor]:
    """Train a family; returns the returns (m + 1, m) of corners and balance before and after."""
    torch.manual_seed(options.seed)
    env = TradeoffEnv(options, options.num_envs)
    names = ("observation_space", "state_space", "action_space", "device")
    spaces = {name: getattr(env, name) for name in names}
    model = Family(**spaces)
    memory = RandomMemory(memory_size=50, num_envs=env.num_envs, device=env.device)
    cfg = {"rollouts": 50, "learning_epochs": 4, "mini_batches": 4, "discount_factor": 0.97}
    cfg |= {"value_clip": 0.0, "experiment": {"write_interval": 0, "checkpoint_interval": 0}}
    agent = PPO(models={"policy": model, "value": model}, memory=memory, cfg=cfg, **spaces)

    balance = env.dirichlet.mean[None]  # (1, m)
    tradeoffs = torch.cat([torch.eye(balance.shape[1], device=env.device), balance])
    before = evaluate(options, agent, tradeoffs)
    cfg = {"timesteps": 50 * options.iterations, "close_environment_at_exit": False}
    SequentialTrainer(env=env, agents=agent, cfg=cfg).train()
    after = evaluate(options, agent, tradeoffs)
    for tradeoff, old, new in zip(tradeoffs.tolist(), before.int(), after.int(), strict=True):
        print(f"{env.vector.objectives} under {tradeoff}: {old.tolist()} -> {new.tolist()}")
    return before, after


if __name__ == "__main__":
    train(tyro.cli(Options, description=__doc__))
