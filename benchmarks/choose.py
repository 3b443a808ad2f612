"""Check that `choose` keeps its requirements and comes close to the best that they allow.

    python benchmarks/choose.py --output benchmarks/results/choose

For each robot, requirements are drawn: two objectives at random, and for the first a least return
between 20 and 80 % of its range on the front; the second is maximized. The chosen trade-off is
simulated again, by a loop over one world that calls the loaded policy. The reference are many
simulated trade-offs, as `evaluate` spreads them. The loss is what the chosen policy, simulated
again, lacks to the best of them that keeps the requirement, in units of that return or, if that is
larger, of the objective's range in the reference.

Robots with `+noise` start at random (task.reset_noise 0.1). Their choices are simulated again in
256 episodes with other random numbers, and their losses are within the error of these means.

Writes OUTPUT.csv, one row per requirement, and OUTPUT.md, the table. To merge rows:

    python benchmarks/choose.py --robots --given first.csv second.csv --output results
"""

import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
import torch
import tyro
from row_files import markdown, read_tuples, write_rows

from morlax_torch import MorlaxError, Policy, envs, load
from morlax_torch.commands.terminal.cli import console
from morlax_torch.evaluation.evaluator import Evaluator, evaluation_worlds
from morlax_torch.evaluation.front import Front
from morlax_torch.runs.choosing import choose
from morlax_torch.runs.loading import evaluate, load_front

ROBOTS = (
    *("cheetah", "walker", "hopper", "ant", "humanoid", "cheetah3", "bruce", "go1"),
    "cheetah+noise",
)
NOISE = 0.1  # task.reset_noise of robots that start at random
FRESH, EPISODES = 1000, 256  # random seed and number of the episodes that check them


class Row(NamedTuple):
    """A requirement and what came of it."""

    robot: str
    required: str
    least: float
    maximized: str
    tradeoff: str
    promised: float  # of the required objective
    simulated: float  # likewise, printed by `choose`
    again: float  # likewise, simulated again
    missed: bool
    value: float  # of the maximized objective, simulated again
    best: float  # of the reference
    loss: float
    simulations: int
    seconds: float
    reference: int  # number of trade-offs


def main(
    robots: tuple[str, ...] = ROBOTS,
    requirements: int = 30,
    reference: int = 4096,
    seed: int = 0,
    device: str | None = None,
    given: tuple[Path, ...] = (),
    output: Path = Path("choose"),
) -> None:
    """Draw requirements, choose, simulate again and write the table.

    Args:
        robots: Shipped policies.
        requirements: Number of requirements per robot.
        reference: Number of simulated trade-offs to compare with.
        seed: Random seed of the requirements.
        device: cuda or cpu (None: CUDA if available).
        given: Files with rows that were measured before.
        output: Path of the files, without suffix.
    """
    target = str(envs.resolve_device(device))
    rows = [row for path in given for row in read_tuples(Row, path)]
    for name in robots:
        try:
            robot = Robot(name, reference, target)
        except MorlaxError as error:
            console.print(f"{name} is skipped: {error}")
            continue
        random = np.random.default_rng(seed)
        for _ in range(requirements):
            rows.append(robot.row(*draw(robot.front, random)))
            console.print(" ".join(map(str, rows[-1])))
            write(rows, output)
    write(rows, output)
    console.print(output.with_suffix(".md").read_text())


def draw(front: Front, random: np.random.Generator) -> tuple[int, float, int]:
    """Draw an objective, its required return, and the objective to maximize."""
    required, maximized = random.permutation(len(front.objectives))[:2]
    low, high = front.returns[:, required].min(), front.returns[:, required].max()
    return required, float(low + (high - low) * random.uniform(0.2, 0.8)), maximized


class Robot:
    """A shipped policy, its front and the simulated reference."""

    def __init__(self, name: str, reference: int, device: str):
        self.name, self.device = name, device
        self.shipped, _, noise = name.partition("+")
        self.policy, self.front = load(self.shipped, device), load_front(self.shipped)
        if noise:
            config = self.policy.config.with_task(reset_noise=NOISE)
            self.policy = Policy(self.policy.agent, config, self.policy.objectives)
        self.random = self.policy.config.task.for_evaluation().varies
        seeds = 8 if self.random else 1
        self.reference = evaluate(self.policy, reference, device=device, seeds=seeds)

    def row(self, required: int, least: float, maximized: int) -> Row:
        """Choose and simulate again."""
        names, returns = self.front.objectives, self.reference.returns
        # a policy with another task than its run is given as such, without a front
        run = self.policy if self.random else self.shipped
        began = time.perf_counter()
        choice = choose(run, {names[required]: least}, names[maximized], device=self.device)
        seconds = time.perf_counter() - began
        again = self.again(choice.tradeoff)
        best = returns[returns[:, required] >= least][:, maximized].max()
        unit = max(abs(best), np.ptp(returns[:, maximized]))
        return Row(
            self.name,
            names[required],
            round(least, 2),
            names[maximized],
            " ".join(map(str, choice.tradeoff)),
            round(choice.promised[names[required]], 2),
            round(choice.returns[names[required]], 2),
            round(float(again[required]), 2),
            bool(again[required] < least),
            round(float(again[maximized]), 2),
            round(float(best), 2),
            round(float((best - again[maximized]) / unit), 5),
            choice.simulated,
            round(seconds, 1),
            len(returns),
        )

    @torch.no_grad()
    def again(self, tradeoff: tuple[float, ...]) -> np.ndarray:
        """Simulate a trade-off without the code of `choose`: returns (m,)."""
        if self.random:
            config = self.policy.config.model_copy(update={"device": self.device, "backend": None})
            env = evaluation_worlds(config, 1, EPISODES, FRESH)
            one = torch.tensor([tradeoff])
            fresh = Evaluator(self.policy.agent, env, one, seed=FRESH, seeds=EPISODES)
            return fresh.evaluate().returns[0]
        policy = load(self.shipped, self.device)
        task = policy.config.task.for_evaluation().model_dump()
        env = envs.make(policy.config.env, 1, self.device, auto_reset=False, **task)
        observation, returns = env.reset(), torch.zeros(1, len(policy.objectives))
        for _ in range(env.episode_length):
            step = env.step(policy(observation, tradeoff))
            returns += step.reward.cpu()
            if step.terminated or step.truncated:
                break
            observation = step.observation
        return returns[0].double().numpy()


def write(rows: list[Row], output: Path) -> None:
    """Write the rows, and the table by robot."""
    output.parent.mkdir(parents=True, exist_ok=True)
    write_rows(output.with_suffix(".csv"), [row._asdict() for row in rows], Row._fields)
    heads = ["robot", "objectives", "requirements", "missed", "loss: median", "largest"]
    heads += ["over 1 %", "simulated: median", "seconds: median"]
    lines = []
    for name in dict.fromkeys(row.robot for row in rows):
        own = [row for row in rows if row.robot == name]
        losses = [row.loss for row in own]
        counts = len(own[0].tradeoff.split()), len(own), sum(row.missed for row in own)
        large = sum(loss > 0.01 for loss in losses)
        simulations = median(row.simulations for row in own)
        seconds = median(row.seconds for row in own)
        cells = [*map(str, counts), f"{median(losses):.2%}", f"{max(losses):.2%}", str(large)]
        lines.append([name, *cells, f"{simulations:.0f}", f"{seconds:.1f}"])
    output.with_suffix(".md").write_text(markdown(heads, lines))


if __name__ == "__main__":
    tyro.cli(main)
