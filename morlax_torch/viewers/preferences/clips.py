"""Short clips of a run's policies, to compare."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ... import envs
from ...configuration.tradeoffs import dirichlet_tradeoffs
from ...envs import Environment, MorlaxError
from ...envs.worlds.learned import TERM
from ...host.phases import phase
from ...networks.policy import Policy

SECONDS = 1.5  # length of a clip
LONGEST = 1000  # control steps of an episode that clips are cut from


class Clips(NamedTuple):
    """n clips of L control steps each."""

    observation: NDArray[np.float32]  # (n, L + 1, O)
    action: NDArray[np.float32]  # (n, L, A)
    qpos: NDArray[np.float32]  # (n, L + 1, nq), to show them
    terms: NDArray[np.float32]  # (n, k) sums of the task's own reward terms


def record(policy: Policy, number: int, seed: int = 0) -> tuple[Clips, list[str]]:
    """Record clips of random trade-offs, each at a random time of an episode, on C MuJoCo.

    Every second clip shows the policy with its exploration noise, so that clips also show what
    training may try.

    Some of the `number` episodes may end too early for a clip. The policy is on the CPU.

    Returns:
        The clips, and the names of their reward terms.

    Raises:
        MorlaxError: the task has no MuJoCo robot, or no episode is as long as a clip.
    """
    config, m = policy.config, len(policy.objectives)
    if not issubclass(envs.get(config.env), Environment):
        raise MorlaxError(f"{config.env} has no MuJoCo robot, so its clips cannot be compared.")
    options = config.task.for_evaluation().model_dump()
    env = envs.make(config.env, number, "cpu", "mujoco", seed, auto_reset=False, **options)
    assert isinstance(env, Environment)
    policy.agent.check_sizes(env)
    length, steps = max(1, round(SECONDS / env.dt)), min(env.episode_length, LONGEST)
    actors = policy.agent.actors(dirichlet_tradeoffs(number, m, seed=seed))
    generator = torch.Generator().manual_seed(seed)
    names = [name for name in env.reward_terms if name != TERM]  # that the task itself defines
    alive = torch.full((number,), steps)
    observation = env.reset()
    seen, positions, actions, terms = [observation], [env.physics.qpos.clone()], [], []
    with torch.no_grad():
        for time in range(steps):
            phase(f"recording {number} clips", time / steps)
            chosen = actors.distribution(observation[:, None])
            noise = chosen.noise(generator)
            noise[::2] = 0
            actions.append((chosen.mean + chosen.std * noise).tanh()[:, 0])
            step = env.step(actions[-1])
            observation = step.observation
            seen.append(observation)
            positions.append(env.physics.qpos.clone())
            terms.append(torch.stack([step.terms[name] for name in names], -1))
            alive[step.terminated] = alive[step.terminated].clamp(max=time)
    whole = torch.nonzero(alive >= length).squeeze(-1)
    if len(whole) < 2:
        raise MorlaxError(
            f"{number - len(whole)} of {number} episodes fail within {SECONDS:g} s, the length of "
            "a clip, so there are no two to compare: train for longer, or record more clips."
        )
    latest = (alive - length)[whole]
    draws = torch.rand(len(whole), generator=generator, dtype=torch.float32)
    first = (draws * (latest + 1)).long().minimum(latest)
    times = first[:, None] + torch.arange(length + 1)

    def cut(values: list[torch.Tensor], times: torch.Tensor = times) -> np.ndarray:
        return torch.stack(values)[times, whole[:, None]].float().numpy()

    inside = times[:, :-1]
    clips = Clips(cut(seen), cut(actions, inside), cut(positions), cut(terms, inside).sum(1))
    return clips, names
