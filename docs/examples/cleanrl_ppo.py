"""PPO in one file, in the style of CleanRL; worlds and learner share one device.

python docs/examples/cleanrl_ppo.py --env-id morlax_torch/Cheetah-v0 --tradeoff 0.7 0.3
"""

import time
from dataclasses import dataclass

import gymnasium
import torch
import tyro
from torch import Tensor, nn
from torch.distributions import Normal

import morlax_torch  # noqa: F401  registers the environment ids
from morlax_torch.adapters.episode_statistics import EpisodeStatistics


@dataclass
class Settings:
    """Command-line options."""

    env_id: str = "morlax_torch/Cheetah-v0"
    """Gymnasium id of a morlax_torch task."""
    tradeoff: tuple[float, ...] = (0.7, 0.3)
    """Weight of each objective."""
    device: str = "cuda" if torch.cuda.is_available() else "cpu"
    """Device of worlds and learner."""
    total_timesteps: int = 2_000_000
    """Control steps to train for, summed over all worlds."""
    num_envs: int = 256
    """Number of parallel worlds."""
    episode_length: int = 1000
    """Control steps after which an episode is truncated."""
    num_steps: int = 32
    """Control steps per rollout in each world."""
    epochs: int = 4
    """Passes over each rollout."""
    minibatches: int = 8
    """Minibatches per pass."""
    learning_rate: float = 1e-3
    """Initial learning rate of Adam, annealed linearly to zero."""
    gamma: float = 0.97
    """Discount factor per control step."""
    gae_lambda: float = 0.95
    """Lambda of generalized advantage estimation."""
    clip: float = 0.2
    """Largest change of the probability ratio that counts."""
    entropy_weight: float = 0.0
    """Weight of the entropy bonus."""
    value_weight: float = 0.5
    """Weight of the value loss."""
    max_grad_norm: float = 0.5
    """Maximum gradient norm."""
    seed: int = 1
    """Random seed of networks, actions and worlds."""


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
    """Train a policy and print its progress.

    Returns:
        The mean scalarized return of finished episodes, one entry per iteration with any.
    """
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

    observations, actions = storage(sizes[0]), storage(sizes[1])
    final_observations = storage(sizes[0])
    log_probs, rewards, dones, failures = storage(), storage(), storage(), storage()
    episode_ended, episode_return = storage(), storage()

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
            observations[t] = observation
            observation, rewards[t], terminated, truncated, info = envs.step(
                actions[t].clamp(-1, 1)
            )
            # worlds reset within the step, so the state after the action is final_obs
            final_observations[t] = info["final_obs"]
            failures[t], dones[t] = terminated, terminated | truncated
            episode_ended[t], episode_return[t] = info["_episode"], info["episode"]["r"] @ weights

        with torch.no_grad():  # bootstrap after a time limit, not after a failure
            values = agent.value(observations)
            next_value = agent.value(final_observations) * (1 - failures)
            td_error = rewards + args.gamma * next_value - values
            advantages, running = torch.empty_like(td_error), torch.zeros_like(td_error[0])
            for t in reversed(range(args.num_steps)):
                decay = args.gamma * args.gae_lambda * (1 - dones[t])
                running = advantages[t] = td_error[t] + decay * running
            targets = advantages + values

        columns = [observations, actions, log_probs, advantages, targets]
        batch = [column.flatten(0, 1) for column in columns]
        for _ in range(args.epochs):
            order = torch.randperm(len(batch[0]), device=device)
            for rows in order.chunk(args.minibatches):
                observation_rows, action, log_prob, advantage, target = (x[rows] for x in batch)
                policy = agent.policy(observation_rows)
                ratio = (policy.log_prob(action).sum(-1) - log_prob).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
                loss = -torch.min(ratio * advantage, clipped * advantage).mean()
                loss += args.value_weight * (agent.value(observation_rows) - target).square().mean()
                loss -= args.entropy_weight * policy.entropy().sum(-1).mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
                optimizer.step()

        if episode_ended.any():
            returns.append((episode_return.sum() / episode_ended.sum()).item())
            steps = (iteration + 1) * args.num_steps * args.num_envs
            rate = steps / (time.perf_counter() - start)
            print(f"{steps:>10,} steps   return {returns[-1]:8.1f}   {rate:8,.0f} steps/s")
    return returns


if __name__ == "__main__":
    train(tyro.cli(Settings))
