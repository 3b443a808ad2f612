"""Print the widths at which AMOR has as many trainable parameters as MORLAX, as lines of YAML.

    python benchmarks/matched_widths.py --tasks cheetah hopper walker ant humanoid

Actor and critic, with two hidden layers of equal width, are matched with the hypernetworks of actor
and critic, each by itself, in the configs for GPUs. compare_methods.yaml has the lines.
"""

from collections.abc import Sequence
from itertools import pairwise

import tyro

from morlax_torch import envs
from morlax_torch.algorithms.learner import make_agent
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import merged, task_values

WIDEST = 4096


def main(tasks: tuple[str, ...] = ("cheetah", "hopper", "walker", "ant", "humanoid")) -> None:
    """Print the widths of every task, and the parameters of both algorithms.

    Args:
        tasks: Tasks to compare on.
    """
    for task in tasks:
        wanted = parameters(task, "morlax")
        widths = matched(task, wanted)
        network = {part: [width, width] for part, width in widths.items()}
        found = parameters(task, "amor", network)
        changes = ", ".join(f"network.{part}: {layers}" for part, layers in network.items())
        console.print(f"{task}: {{{changes}}}")
        counts = ", ".join(f"{part} {found[part]:,} of {wanted[part]:,}" for part in wanted)
        console.print(f"# parameters: {counts}")


def matched(task: str, wanted: dict[str, int]) -> dict[str, int]:
    """Return the widths of AMOR's actor and critic whose parameters are nearest to `wanted`."""
    env = envs.make(task, 1, "cpu")
    seen, m = env.observation_size, len(env.objectives)
    ends = {
        "actor": (seen + m, 2 * env.action_size),
        "critic": (seen + env.privileged_size + m, m),
    }
    return {
        part: min(
            range(1, WIDEST),
            key=lambda width, part=part: abs(
                mlp_parameters((ends[part][0], width, width, ends[part][1])) - wanted[part]
            ),
        )
        for part in ends
    }


def mlp_parameters(sizes: Sequence[int]) -> int:
    """Return how many weights and biases an MLP with layers of these sizes has."""
    return sum((before + 1) * after for before, after in pairwise(sizes))


def parameters(
    task: str, algorithm: str, network: dict[str, list[int]] | None = None
) -> dict[str, int]:
    """Return how many trainable parameters actor and critic have in a task's config for GPUs.

    Args:
        task: the task.
        algorithm: of the agent.
        network: hidden layers of "actor" and "critic", instead of the config's.
    """
    values = task_values(task, "cuda", algorithm)
    config = load_config(merged(values, {"network": network or {}}))
    env = envs.make(task, 1, "cpu")
    agent = make_agent(env, config)
    families = {"actor": agent.actor, "critic": agent.critic}
    return {name: sum(p.numel() for p in part.parameters()) for name, part in families.items()}


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
