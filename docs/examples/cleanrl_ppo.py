"""PPO in one file, in the manner of CleanRL: robots and learner on one device, in torch tensors.

python docs/examples/cleanrl_ppo.py --env-id morlax_torch/Cheetah-v0 --tradeoff 0.7 0.3
"""

import time
from dataclasses import dataclass

import gymnasium
import torch
import tyro
from torch import Tensor, nn
from torch.distributions import Normal

import morlax_torch  # noqa: F401  makes the ids known
from morlax_torch.adapters.episode_statistics import EpisodeStatistics


@dataclass
class Settings:
    """What can be changed."""

    env_id: str = "morlax_torch/Cheetah-v0"
    """one of our ids"""
    tradeoff: tuple[float, ...] = (0.7, 0.3)
    """how much each objective matters"""
    device: str = "cuda" if torch.cuda.is_available() else "cpu"
    """of robots and learner"""
    total_timesteps: int = 2_000_000
    """control steps, over all worlds"""
    num_envs: int = 256
    """worlds"""
    episode_length: int = 1000
    """control steps after which time is up"""
    num_steps: int = 32
    """control steps of a rollout, in each world"""
    epochs: int = 4
    """passes over a rollout"""
    minibatches: int = 8
    """parts of a pass"""
    learning_rate: float = 1e-3
    """of Adam, falling to zero"""
    gamma: float = 0.97
    """discount of a control step"""
    gae_lambda: float = 0.95
    """how far advantages look ahead"""
    clip: float = 0.2
    """how far the ratio of probabilities may leave one"""
    entropy_weight: float = 0.0
    """reward for being undecided"""
    value_weight: float = 0.5
    """of the critic's loss"""
    max_grad_norm: float = 0.5
    """longest gradient"""
    seed: int = 1
    """of networks, actions and worlds"""


def network(inputs: int, outputs: int, last_gain: float) -> nn.Sequential:
    layers = [nn.Linear(inputs, 64), nn.Linear(64, 64), nn.Linear(64, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, last_gain), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


class Agent(nn.Module):
    def __init__(self, observation_size: int, action_size: int):
        super().__init__()
        self.actor = network(observation_size, action_size, 0.01)
        self.critic = network(observation_size, 1, 1.0)
        self.log_std = nn.Parameter(torch.zeros(action_size))

    def policy(self, observation: Tensor) -> Normal:
        return Normal(self.actor(observation), self.log_std.exp(), validate_args=False)

    def value(self, observation: Tensor) -> Tensor:
        return self.critic(observation).squeeze(-1)


def train(args: Settings) -> list[float]:
    """Train, and print how it goes; the mean return of the episodes that ended, by iteration."""
    torch.manual_seed(args.seed)
    device = torch.device(args.device)
    envs = EpisodeStatistics(
        gymnasium.make_vec(
            args.env_id,
            num_envs=args.num_envs,
            device=device,
            tradeoff=args.tradeoff,
            episode_length=args.episode_length,
        )
    )
    weights = torch.tensor(args.tradeoff, device=device)
    sizes = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(*sizes).to(device)
    optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate, eps=1e-5)

    def storage(*shape: int) -> Tensor:
        return torch.zeros(args.num_steps, args.num_envs, *shape, device=device)

    seen, final, actions = storage(sizes[0]), storage(sizes[0]), storage(sizes[1])
    log_probs, rewards, dones, failures = storage(), storage(), storage(), storage()
    ended, paid = storage(), storage()

    observation, _ = envs.reset(seed=args.seed)
    iterations = args.total_timesteps // (args.num_steps * args.num_envs)
    returns, start = [], time.perf_counter()
    for iteration in range(iterations):
        optimizer.param_groups[0]["lr"] = args.learning_rate * (1 - iteration / iterations)

        for t in range(args.num_steps):
            with torch.no_grad():
                policy = agent.policy(observation)
                actions[t] = policy.sample()
                log_probs[t] = policy.log_prob(actions[t]).sum(-1)
            seen[t] = observation
            observation, rewards[t], terminated, truncated, info = envs.step(
                actions[t].clamp(-1, 1)
            )
            # worlds reset in the same step: the state that an action led to is final_obs
            final[t], failures[t], dones[t] = info["final_obs"], terminated, terminated | truncated
            ended[t], paid[t] = info["_episode"], info["episode"]["r"] @ weights

        with torch.no_grad():  # a failure has no future, a time limit has
            values, future = agent.value(seen), agent.value(final) * (1 - failures)
            surprise = rewards + args.gamma * future - values
            advantages, running = torch.empty_like(surprise), torch.zeros_like(surprise[0])
            for t in reversed(range(args.num_steps)):
                carry = args.gamma * args.gae_lambda * (1 - dones[t])
                running = advantages[t] = surprise[t] + carry * running
            targets = advantages + values

        columns = [seen, actions, log_probs, advantages, targets]
        batch = [column.flatten(0, 1) for column in columns]
        for _ in range(args.epochs):
            order = torch.randperm(len(batch[0]), device=device)
            for rows in order.chunk(args.minibatches):
                observations, action, log_prob, advantage, target = (x[rows] for x in batch)
                policy = agent.policy(observations)
                ratio = (policy.log_prob(action).sum(-1) - log_prob).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
                loss = -torch.min(ratio * advantage, clipped * advantage).mean()
                loss += args.value_weight * (agent.value(observations) - target).square().mean()
                loss -= args.entropy_weight * policy.entropy().sum(-1).mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
                optimizer.step()

        if ended.any():
            returns.append((paid.sum() / ended.sum()).item())
            steps = (iteration + 1) * args.num_steps * args.num_envs
            rate = steps / (time.perf_counter() - start)
            print(f"{steps:>10,} steps   return {returns[-1]:8.1f}   {rate:8,.0f} steps/s")
    return returns


if __name__ == "__main__":
    train(tyro.cli(Settings))
