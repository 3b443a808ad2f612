"""MORLAX in one file: one hypernetwork that turns any trade-off into a policy.

    python docs/examples/morlax.py --env cheetah --max-seconds 60

It trains as `python -m morlax_torch.train` does, number for number on a CPU, which a test shows.
The package adds speed on a GPU (recorded graphs, fused kernels), checkpoints and other algorithms.

Shapes: N worlds, K clusters of G = N / K worlds with one trade-off, T steps, m objectives,
S samples of a minibatch, O numbers of an observation, A of an action, P parameters.
"""

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap
from torch.nn.functional import softplus
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from morlax_torch import envs


@dataclass
class Options:
    """Command-line options; the defaults suit cheetah and hopper on a CPU."""

    env: str = "cheetah"  # a task of two objectives
    device: str = "cuda" if torch.cuda.is_available() else "cpu"
    seed: int = 0
    max_seconds: float = 60.0  # of training
    worlds: int = 256  # N
    clusters: int = 8  # K, of which one per objective has a corner: a trade-off of that one alone
    horizon: int = 32  # T
    epochs: int = 3  # passes over a rollout
    minibatches: int = 4  # per pass; divides the worlds of a cluster
    width: int = 64  # of both hidden layers of every generated actor and critic
    hidden: int = 128  # width of both hidden layers of the hypernetworks
    features: int = 16  # F, that generated parameters are affine in
    learning_rate: float = 1e-3
    discount: float = 0.98
    gae_lambda: float = 0.95
    clip: float = 0.2  # of the probability ratio
    entropy: float = 0.03  # weight of the entropy bonus
    decay_fraction: float = 0.5  # share of the run, at its end, over which rates decay to zero
    tradeoffs: int = 128  # to evaluate


def mlp(inputs: int, hidden: int, outputs: int, generator: torch.Generator) -> nn.Sequential:
    """Build two hidden layers with SiLU and a linear one, with LeCun-uniform weights."""
    layers: list[nn.Module] = []
    for before, after in pairwise((inputs, hidden, hidden, outputs)):
        linear = nn.Linear(before, after)
        bound = math.sqrt(3 / before)
        nn.init.uniform_(linear.weight, -bound, bound, generator)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.SiLU()]
    return nn.Sequential(*layers[:-1])


class Hypernetwork(nn.Module):
    """One network for every trade-off w, with parameters H(w) = M f(w) + b.

    M starts at zero and b as the parameters of `target`: every trade-off starts as that network.
    """

    def __init__(self, target: nn.Module, m: int, options: Options, generator: torch.Generator):
        super().__init__()
        self.target = (target,)  # the tuple hides its parameters, which are not trained
        self.shapes = {name: value.shape for name, value in target.named_parameters()}
        self.features = mlp(m, options.hidden, options.features, generator)  # f
        bias = parameters_to_vector(target.parameters()).detach()
        weight = torch.empty(len(bias), options.features)
        self.weight = nn.Parameter(nn.init.uniform_(weight, 0.0, 0.0, generator))  # M (P, F)
        self.bias = nn.Parameter(bias)  # b (P,)

    def forward(self, tradeoffs: Tensor) -> dict[str, Tensor]:
        """Map trade-offs (K, m) to the parameters of K networks, (K, ...) each."""
        tradeoffs = tradeoffs / tradeoffs.sum(-1, keepdim=True)
        flat = torch.addmm(self.bias, self.features(tradeoffs), self.weight.T)  # (K, P)
        parts = flat.split([shape.numel() for shape in self.shapes.values()], -1)
        named = zip(self.shapes.items(), parts, strict=True)
        return {name: part.reshape(-1, *shape) for (name, shape), part in named}

    def run(self, parameters: dict[str, Tensor], inputs: Tensor) -> Tensor:
        """Run K networks, each on its own inputs (K, B, ...); returns (K, B, ...)."""
        return vmap(lambda own, x: functional_call(self.target[0], own, x))(parameters, inputs)


class TanhNormal:
    """A Gaussian squashed by tanh; `output` (..., 2A) holds means and spreads of an actor."""

    def __init__(self, output: Tensor):
        self.mean, spread = output.chunk(2, -1)
        self.std = softplus(spread) + 1e-3

    def log_slope(self, action: Tensor) -> Tensor:
        """Return log(d tanh(u) / du) in a form that does not overflow."""
        return 2 * (math.log(2) - action - softplus(-2 * action))

    def log_prob(self, action: Tensor) -> Tensor:
        """Return the log-density (...) of tanh(action), for actions (..., A) before the tanh."""
        standard = (action - self.mean) / self.std
        gaussian = -0.5 * standard.square() - self.std.log() - 0.5 * math.log(2 * math.pi)
        return (gaussian - self.log_slope(action)).sum(-1)

    def entropy(self, noise: Tensor) -> Tensor:
        """Estimate the entropy (...) from standard normal noise (..., A)."""
        gaussian = 0.5 + 0.5 * math.log(2 * math.pi) + self.std.log()
        return (gaussian + self.log_slope(self.mean + self.std * noise)).sum(-1)


class Normalizer(nn.Module):
    """Standardizes features by their running mean and variance."""

    def __init__(self, size: int):
        super().__init__()
        self.mean = nn.Buffer(torch.zeros(size))
        self.variance = nn.Buffer(torch.ones(size))
        self.scale = nn.Buffer(torch.ones(size))  # one over the standard deviation
        self.count = nn.Buffer(torch.zeros((), dtype=torch.float64))

    def forward(self, x: Tensor) -> Tensor:
        return ((x - self.mean) * self.scale).clamp(-10.0, 10.0)

    def inverse(self, x: Tensor) -> Tensor:
        return x / self.scale + self.mean

    def update(self, x: Tensor, weight: Tensor | float = 1.0) -> None:
        """Merge samples (..., size) into the statistics (Chan et al., 1979)."""
        x = x.flatten(0, -2)
        variance, mean = torch.var_mean(x, 0, correction=0)
        self.count += len(x)
        share, shift = (len(x) / self.count).float() * weight, mean - self.mean
        self.variance.lerp_(variance, share).add_(shift.square() * share * (1 - share))
        self.mean.add_(shift * share)
        self.scale.copy_((self.variance + 1e-8).rsqrt())


class Rollout(NamedTuple):
    """T steps of K clusters of G worlds."""

    observation: Tensor  # (T, K, G, O)
    action: Tensor  # (T, K, G, A) before the tanh
    log_prob: Tensor  # (T, K, G)
    reward: Tensor  # (T, K, G, m)
    terminated: Tensor  # (T, K, G) bool: the robot failed
    truncated: Tensor  # (T, K, G) bool: the episode reached its time limit
    final_observation: Tensor  # (T, K, G, O) after the step, before any reset


def advantages(rollout: Rollout, value: Tensor, final_value: Tensor, options: Options) -> Tensor:
    """Estimate generalized advantages (T, K, G, m), one objective at a time.

    (Schulman et al., 2016, eq. 16.) A failure has no future value; a time limit keeps the critic's
    value of the last observation before the reset. `value` and `final_value` are (T, K, G, m).
    """
    terminated, truncated = rollout.terminated[..., None], rollout.truncated[..., None]
    following = torch.where(terminated, 0.0, final_value)
    surprise = rollout.reward + options.discount * following - value
    carry = torch.where(terminated | truncated, 0.0, options.discount * options.gae_lambda)
    advantage, running = torch.empty_like(surprise), torch.zeros_like(surprise[0])
    for t in reversed(range(len(surprise))):
        running = torch.addcmul(surprise[t], carry[t], running)
        advantage[t] = running
    return advantage


class Adam:
    """Adam on gradients scaled down to a norm of at most 1, for one flat vector of parameters."""

    def __init__(self, family: Hypernetwork, options: Options):
        self.parameters = list(family.parameters())
        self.vector = nn.Parameter(parameters_to_vector(self.parameters).detach())
        vector_to_parameters(self.vector, self.parameters)  # which are views of it from now on
        self.initial = self.vector.new_tensor(options.learning_rate)
        self.adam = torch.optim.Adam([self.vector], self.initial.clone(), fused=True)

    def step(self, loss: Tensor, decay: Tensor) -> None:
        """Descend the gradient of a loss, with the initial learning rate times `decay` ()."""
        self.adam.param_groups[0]["lr"].copy_(self.initial * decay)
        gradient = parameters_to_vector(torch.autograd.grad(loss, self.parameters))
        self.vector.grad = gradient / gradient.norm().clamp(min=1.0)
        self.adam.step()


class MORLAX:
    """Alternates rollouts of K policies and PPO updates of two hypernetworks."""

    def __init__(self, env: envs.Worlds, options: Options):
        self.env, self.options = env, options
        self.m, device = len(env.objectives), env.device
        initial = torch.Generator().manual_seed(options.seed)
        actor = mlp(env.observation_size, options.width, 2 * env.action_size, initial)
        with torch.no_grad():  # a standard deviation of log(2) + 0.001 at first
            actor[-1].bias[env.action_size :] = math.log(math.expm1(math.log(2)))
        critic = mlp(env.observation_size, options.width, self.m, initial)
        self.actor = Hypernetwork(actor.to(device), self.m, options, initial).to(device)
        self.critic = Hypernetwork(critic.to(device), self.m, options, initial).to(device)
        self.observations = Normalizer(env.observation_size).to(device)
        self.values = Normalizer(self.m).to(device)
        self.optimizers = [Adam(family, options) for family in (self.actor, self.critic)]
        self.generator = torch.Generator(device).manual_seed(options.seed)
        self.observation = env.reset().clone()  # (N, O)

    def iterate(self, done: float) -> None:
        """Explore and learn once, when a share `done` of training is over."""
        ones = torch.ones(self.options.clusters, self.m, device=self.env.device)
        tradeoffs = torch._standard_gamma(ones, generator=self.generator)
        tradeoffs /= tradeoffs.sum(-1, keepdim=True)  # (K, m), uniform on the simplex
        tradeoffs[-self.m :] = torch.eye(self.m)  # the last ones are its corners
        self.learn(tradeoffs, self.explore(tradeoffs), ones.new_tensor(done))

    @torch.no_grad()
    def explore(self, tradeoffs: Tensor) -> Rollout:
        """Let the policy of each trade-off act for T steps in its G worlds."""
        parameters = self.actor(tradeoffs)
        T, K, A = self.options.horizon, len(tradeoffs), self.env.action_size
        noise = torch.empty(T, K, self.env.num_worlds // K, A, device=self.env.device)
        noise.normal_(generator=self.generator)
        steps = []
        for t in range(T):
            observation = self.observation.view(K, -1, self.env.observation_size)
            policy = TanhNormal(self.actor.run(parameters, self.observations(observation)))
            action = policy.mean + policy.std * noise[t]
            step = self.env.step(action.tanh().flatten(0, 1))
            results = step.reward, step.terminated, step.truncated, step.final_observation
            clusters = (result.unflatten(0, (K, -1)) for result in results)
            steps.append((observation, action, policy.log_prob(action), *clusters))
            self.observation = step.observation.clone()
        return Rollout(*(torch.stack(column) for column in zip(*steps, strict=True)))

    def learn(self, tradeoffs: Tensor, rollout: Rollout, done: Tensor) -> None:
        """Update both hypernetworks with PPO, then the observation normalizer."""
        options = self.options
        decay = ((1 - done) / options.decay_fraction).clamp(max=1.0)
        actor, critic = self.optimizers
        batch = self.make_batch(tradeoffs, rollout)
        for _ in range(options.epochs):
            for observation, action, log_prob, advantage, target, noise in self.deal(*batch):
                policy = TanhNormal(self.actor.run(self.actor(tradeoffs), observation))
                ratio = (policy.log_prob(action) - log_prob).exp()
                clipped = ratio.clamp(1 - options.clip, 1 + options.clip)
                surrogate = -torch.minimum(ratio * advantage, clipped * advantage).mean()
                bonus = options.entropy * decay * policy.entropy(noise).mean()
                actor.step(surrogate - bonus, decay)
                value = self.critic.run(self.critic(tradeoffs), observation)
                error = (value - target).square().sum(-1).mean()
                critic.step(0.5 * error, decay)
        # only now: during the update the policies must see the inputs that they acted on
        self.observations.update(rollout.observation, decay)

    @torch.no_grad()
    def make_batch(self, tradeoffs: Tensor, rollout: Rollout) -> tuple[Tensor, ...]:
        """Return columns (K, G, T, ...): what PPO learns from a rollout."""

        def value_of(observation: Tensor) -> Tensor:  # (T, K, G, O) -> (T, K, G, m)
            rows = observation.transpose(0, 1).flatten(1, 2)
            value = self.critic.run(self.critic(tradeoffs), rows)
            return self.values.inverse(value.unflatten(1, (len(observation), -1)).transpose(0, 1))

        seen, final = (self.observations(x) for x in (rollout.observation, rollout[-1]))
        value = value_of(seen)
        advantage = advantages(rollout, value, value_of(final), self.options)
        target = advantage + value
        self.values.update(target)
        # one number to ascend: the trade-off weighs the advantage of each objective
        scalar = (advantage * tradeoffs[:, None]).sum(-1)
        variance, mean = torch.var_mean(scalar, correction=0)
        number = scalar.numel()
        scalar = (scalar - mean) / ((variance * number / (number - 1)).sqrt() + 1e-8)
        columns = seen, rollout.action, rollout.log_prob, scalar, self.values(target)
        return tuple(column.movedim(0, 2) for column in columns)

    def deal(self, *columns: Tensor) -> Iterator[tuple[Tensor, ...]]:
        """Deal each cluster's worlds out to minibatches (K, S, ...), with noise (K, S, A)."""
        (K, G), device, number = columns[0].shape[:2], self.env.device, self.options.minibatches
        order = torch.rand(K, G, generator=self.generator, device=device).argsort(1)
        noise = torch.empty(columns[1].numel(), device=device).normal_(generator=self.generator)
        for worlds, part in zip(order.chunk(number, 1), noise.chunk(number), strict=True):
            rows = [column[torch.arange(K)[:, None], worlds].flatten(1, 2) for column in columns]
            yield *rows, part.view_as(rows[1])


@torch.no_grad()
def evaluate(morlax: MORLAX, env: envs.Worlds) -> Tensor:
    """Return the returns (N, m) of N trade-offs on an even grid, one episode each."""
    first = torch.linspace(0, 1, env.num_worlds, device=env.device)
    parameters = morlax.actor(torch.stack([first, 1 - first], -1))
    observation = env.reset()
    returns = torch.zeros(env.num_worlds, morlax.m, device=env.device)
    alive = torch.ones(env.num_worlds, 1, dtype=torch.bool, device=env.device)
    for _ in range(env.episode_length):
        output = morlax.actor.run(parameters, morlax.observations(observation[:, None]))[:, 0]
        step = env.step(output.chunk(2, -1)[0].tanh())
        returns += torch.where(alive, step.reward, 0.0)
        alive &= ~step.terminated[:, None]
        observation = step.observation
    return returns


def hypervolume(returns: Tensor, reference_point: tuple[float, ...]) -> float:
    """Return the area that points (n, 2) dominate beyond the reference point."""
    points = (returns.double().cpu() - torch.tensor(reference_point)).clamp(min=0.0)
    points = points[points[:, 0].argsort(descending=True)]
    widths = points[:, 0] - torch.cat([points[1:, 0], torch.zeros(1)])
    return float((widths * points[:, 1].cummax(0).values).sum())


def train(options: Options) -> tuple[MORLAX, Tensor]:
    """Train for `max_seconds`; returns the learner and the final returns."""
    env = envs.make(options.env, options.worlds, options.device, seed=options.seed)
    morlax = MORLAX(env, options)
    worlds = envs.make(options.env, options.tradeoffs, options.device, auto_reset=False)
    seconds, iteration, next_report = 0.0, 0, 0.0
    while True:
        if seconds >= next_report or seconds >= options.max_seconds:
            returns = evaluate(morlax, worlds)
            volume = hypervolume(returns, worlds.reference_point)
            print(f"{iteration} iterations, {seconds:.1f} s: hypervolume {volume:.4g}", flush=True)
            next_report += options.max_seconds / 3
        if seconds >= options.max_seconds:
            return morlax, returns
        start = time.perf_counter()
        morlax.iterate(seconds / options.max_seconds)
        float(morlax.observations.count)  # waits for a GPU
        seconds, iteration = seconds + time.perf_counter() - start, iteration + 1


def plot(returns: Tensor, objectives: tuple[str, ...], path: str) -> None:
    """Draw the returns (n, 2) of all trade-offs."""
    from matplotlib import pyplot

    pyplot.scatter(*returns.cpu().T, c=torch.linspace(0, 1, len(returns)), s=8)
    pyplot.gca().set(xlabel=f"return of {objectives[0]}", ylabel=f"return of {objectives[1]}")
    pyplot.savefig(path, dpi=150)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for field in fields(Options):
        name = field.name.replace("_", "-")
        parser.add_argument(f"--{name}", type=field.type, default=field.default)
    morlax, returns = train(Options(**vars(parser.parse_args())))
    plot(returns, morlax.env.objectives, "front.png")
