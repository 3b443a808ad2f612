"""Evaluate the policies of a run."""

from ..envs import resolve_device
from ..evaluation.evaluator import Protocol
from ..evaluation.front import Front
from ..evaluation.making import make_evaluator
from ..files import AnyPath
from ..networks.policy import Policy
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
            fixed random draws for more; None: as in training, or the paper's 1,024 random ones.
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
    config = policy.config.model_copy(update={"device": str(place), "backend": backend})
    m = len(policy.objectives)
    evaluator = make_evaluator(policy.agent, config, m, protocol, tradeoffs, seeds, seed)
    evaluator.compile()
    mark = fingerprint(policy.agent.state_dict())
    return evaluator.evaluate()._replace(fingerprint=mark)
