"""Evaluate the policies of a run."""

import torch

from .. import envs
from ..envs import MorlaxError, Worlds, resolve_device
from ..envs.random import EVALUATION_SEEDS
from ..evaluation.evaluator import Evaluator, Protocol
from ..evaluation.front import Front
from ..files import AnyPath
from ..networks.policy import Policy
from ..tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs
from .checkpoint import fingerprint
from .loading import load


def evaluate(
    run: AnyPath | Policy,
    tradeoffs: int | None = None,
    protocol: Protocol = "latched",
    device: str | None = None,
    backend: str | None = None,
    seed: int = 0,
    seeds: int | None = None,
) -> Front:
    """Evaluate a run's best checkpoint, a checkpoint file, a shipped name, or a policy.

    Args:
        run: the policies; a `Policy` is moved to the device.
        tradeoffs: K, the number of trade-offs: an even grid for two objectives; the corners and
            fixed random draws for more; None: as in training.
        protocol: how returns are counted, see `Evaluator`.
        device: "cuda", "cpu", ...; None selects CUDA if there is a GPU.
        backend: "warp" or "mujoco"; None is chosen by device.
        seed: random seed of the worlds, for tasks with random starts or models.
        seeds: episodes per trade-off, each with its own random draws, to average over; None: as in
            training.

    Raises:
        MorlaxError: there is no such run, a number is out of range, or nothing in the task is
            random although `seeds` > 1.
    """
    place = resolve_device(device)
    policy = (run if isinstance(run, Policy) else load(run, place)).to(place)
    tradeoffs = policy.config.evaluation.tradeoffs if tradeoffs is None else tradeoffs
    seeds = policy.config.evaluation.seeds if seeds is None else seeds
    m = len(policy.objectives)
    fixed = evaluation_tradeoffs(tradeoffs, m)
    drawn = dirichlet_tradeoffs(tradeoffs, m) if protocol == "paper" else fixed
    env = evaluation_worlds(policy, tradeoffs, seeds, seed, place, backend)
    evaluator = Evaluator(policy.agent, env, drawn, protocol, seed, seeds)
    evaluator.compile()
    mark = fingerprint(policy.agent.state_dict())
    return evaluator.evaluate()._replace(fingerprint=mark)


def evaluation_worlds(
    policy: Policy,
    tradeoffs: int,
    seeds: int,
    seed: int,
    place: torch.device,
    backend: str | None = None,
) -> Worlds:
    """Make the worlds of an `Evaluator` of a policy: one for each of `seeds` episodes of K.

    Raises:
        MorlaxError: a number is out of range, or nothing in the task is random although
            `seeds` > 1.
    """
    task = policy.config.task.for_evaluation()
    if not 0 <= seed < 2**63:
        raise MorlaxError(f"seed is {seed}: it must be from 0 to 2^63 - 1.")
    if seeds < 1:
        raise MorlaxError(f"seeds is {seeds}: at least one is needed.")
    try:
        task.check_seeds(seeds)
    except ValueError as error:
        raise MorlaxError(f"{error}: leave out --seeds.") from None
    return envs.make(
        policy.config.env,
        tradeoffs * seeds,
        place,
        backend,
        EVALUATION_SEEDS + seed,
        auto_reset=False,
        **task.model_dump(),
    )
