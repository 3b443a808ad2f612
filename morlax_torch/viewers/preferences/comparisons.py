"""Clips of a run's policies, and answers to "which clip is better?", in one file."""

import io
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray

from ... import envs
from ...configuration.tradeoffs import dirichlet_tradeoffs
from ...envs import Environment, MorlaxError
from ...envs.errors import LONGEST, unknown
from ...envs.worlds.learned import TERM
from ...host.files import AnyPath, read, replacing
from ...host.phases import phase
from ...networks.policy import Policy

SECONDS = 1.5  # length of a clip
EPISODE = 1000  # control steps at most of an episode that clips are cut from


class Clips(NamedTuple):
    """n clips of L control steps each."""

    observation: NDArray[np.float32]  # (n, L + 1, O)
    action: NDArray[np.float32]  # (n, L, A)
    qpos: NDArray[np.float32]  # (n, L + 1, nq), to show them
    terms: NDArray[np.float32]  # (n, k) sums of the task's own reward terms


def record(policy: Policy, number: int, seed: int = 0) -> tuple[Clips, list[str]]:
    """Record clips of random trade-offs, each at a random time of an episode, on C MuJoCo.

    Every second clip has exploration noise, to show what training may try. Some of the `number`
    episodes may end too early for a clip. Returns the clips, and the names of their reward terms.
    """
    config, m = policy.config, len(policy.objectives)
    if not issubclass(envs.get(config.env), Environment):
        raise MorlaxError(f"{config.env} has no MuJoCo robot, so its clips cannot be compared.")
    options = config.task.for_evaluation().model_dump()
    env = envs.make(config.env, number, "cpu", "mujoco", seed, auto_reset=False, **options)
    assert isinstance(env, Environment)
    policy.agent.check_sizes(env)
    length, steps = max(1, round(SECONDS / env.dt)), min(env.episode_length, EPISODE)
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
    rows = torch.nonzero(alive >= length).squeeze(-1)
    if len(rows) < 2:
        raise MorlaxError(
            f"fewer than two of {number} episodes last {SECONDS:g} s, the length of a clip: train "
            "for longer, or record more clips."
        )
    latest = (alive - length)[rows]
    draws = torch.rand(len(rows), generator=generator, dtype=torch.float32)
    first = (draws * (latest + 1)).long().minimum(latest)
    times = first[:, None] + torch.arange(length + 1)

    def cut(values: list[torch.Tensor], times: torch.Tensor) -> np.ndarray:
        return torch.stack(values)[times, rows[:, None]].float().numpy()

    action, sums = cut(actions, times[:, :-1]), cut(terms, times[:, :-1]).sum(1)
    return Clips(cut(seen, times), action, cut(positions, times), sums), names


@dataclass
class Comparisons:
    """Clips of one task, and which of two of them a user preferred."""

    task: str
    terms: list[str]  # names of the reward terms of the clips
    clips: Clips
    answers: list[tuple[int, int]] = field(default_factory=list)  # clips, the preferred one first
    sources: list[str] = field(default_factory=list)  # names of where the clips come from
    objective: str | None = None  # that the answers are about; None: not told

    def pair(self, random: np.random.Generator) -> tuple[int, int]:
        """Draw two different clips to compare next, one of them of those compared least."""
        times = np.bincount(np.array(self.answers, int).ravel(), minlength=len(self.clips.action))
        first, *others = np.lexsort([random.random(len(times)), times])
        return int(first), int(random.choice(others))

    def joined(self, other: "Comparisons") -> "Comparisons":
        """Add clips, or raise MorlaxError if they are of another task or of another length."""
        mine, others = ([part.shape[1:] for part in each.clips] for each in (self, other))
        if (other.task, other.terms, others) != (self.task, self.terms, mine):
            raise MorlaxError(f"the clips are of {self.task}: use another folder for {other.task}.")
        clips = Clips(*map(np.concatenate, zip(self.clips, other.clips, strict=True)))
        return replace(self, clips=clips, sources=self.sources + other.sources)

    def judge(self, term: str, number: int, random: np.random.Generator) -> None:
        """Answer `number` comparisons as a simulated user who prefers more of a reward term."""
        if term not in self.terms:
            raise unknown("reward term", term, self.terms)
        ratings = self.clips.terms[:, self.terms.index(term)]
        for _ in range(number):
            one, other = self.pair(random)
            self.answers.append((one, other) if ratings[one] > ratings[other] else (other, one))

    def save(self, path: AnyPath) -> None:
        """Write an .npz atomically, or raise MorlaxError."""
        with replacing(path) as file:
            np.savez_compressed(
                file,
                task=self.task,
                objective=self.objective or "",
                term_names=np.array(self.terms, str),
                sources=np.array(self.sources, str),
                answers=np.array(self.answers, np.int32).reshape(-1, 2),
                **self.clips._asdict(),
            )

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a file that `save` wrote, or raise MorlaxError."""
        content = io.BytesIO(read(path, "file of comparisons"))
        try:
            with np.load(content) as arrays:
                clips = Clips(*(arrays[name] for name in Clips._fields))
                terms, sources = arrays["term_names"].tolist(), arrays["sources"].tolist()
                answers = [(int(a), int(b)) for a, b in arrays["answers"]]
                task, objective = str(arrays["task"]), str(arrays["objective"]) or None
            n, length = clips.action.shape[:2]
            sizes = [(n, length + 1), (n, length), (n, length + 1), (n, len(terms))]
            if [part.shape[:2] for part in clips] != sizes or np.max(answers, initial=0) >= n:
                raise ValueError("its clips and answers do not fit together")
        except MemoryError:
            raise
        except Exception as error:  # numpy, zip and zlib each fail in their own way
            reason = " ".join(str(error).split())[:LONGEST].rstrip(".")
            raise MorlaxError(f"{path} is damaged or has no comparisons: {reason}.") from None
        return cls(task, terms, clips, answers, sources, objective)
