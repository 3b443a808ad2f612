"""Start a new run from the policies of another one, which may have fewer objectives."""

from collections.abc import Mapping

import torch
from torch import Tensor

from ..algorithms.learner import Learner
from ..envs import MorlaxError
from ..networks.hypernetwork import Hypernetwork
from . import checkpoint
from .contents import POLICY
from .loading import find_checkpoint

FIRST_LAYER = "actor.features.0.weight"  # (hidden, m)
CRITIC = ("critic.", "value_normalizer.")


def start_from(run: str, learner: Learner) -> None:
    """Copy another run's actor and observation normalizer into `learner`, in place.

    The learner may have objectives that the run lacks. The policy of a trade-off is then the run's
    policy for the weights of the run's own objectives, each plus an even share of the weights of
    the others, and the critic starts anew. With the same objectives, a critic of the same size is
    copied too. All processes of the learner's group must call it; they start with what the first
    one read.

    Args:
        run: a run's folder, a checkpoint, or a shipped name.
        learner: with a hypernetwork, like the run.

    Raises:
        MorlaxError: there is no such run, it has another objective, or its networks do not fit.
    """
    path = find_checkpoint(run)
    contents = checkpoint.load(path)
    state, agent, objectives = dict(contents.agent), learner.agent, learner.env.objectives
    known = contents.environment.objectives
    for name in known:
        if name not in objectives:
            raise MorlaxError(
                f"{path} has the objective {name}, which this run lacks: its objectives are "
                f"{', '.join(objectives)}."
            )
    if not isinstance(agent.actor, Hypernetwork) or FIRST_LAYER not in state:
        raise MorlaxError(
            f"start_from needs hypernetworks, which {path} or algorithm "
            f"{learner.config.algorithm} lacks."
        )
    columns = [objectives.index(name) for name in known]
    state[FIRST_LAYER] = _widened(state[FIRST_LAYER], len(objectives), columns)
    mine = agent.state_dict()
    kept = [name for name in mine if name.startswith(POLICY)]
    for name in kept:
        if not _fits(state, name, mine):
            raise MorlaxError(
                f"the networks in {path} have other sizes than this run's ({name}): give both the "
                "same network section and the same task."
            )
    critic = [name for name in mine if name.startswith(CRITIC)]
    if tuple(known) == tuple(objectives) and all(_fits(state, name, mine) for name in critic):
        kept += critic
    for name in kept:
        mine[name].copy_(state[name])
    learner.group.share(agent)  # a run in training may have replaced its checkpoint meanwhile


def _fits(state: Mapping[str, Tensor], name: str, mine: Mapping[str, Tensor]) -> bool:
    return name in state and state[name].shape == mine[name].shape


def _widened(weight: Tensor, m: int, columns: list[int]) -> Tensor:
    """Return the weights (hidden, m) of m trade-off inputs, of which `columns` are known.

    The others get the mean, because the first layer then maps their corners to the same features
    as the even trade-off of the known objectives.
    """
    wide = weight.mean(1, keepdim=True).repeat(1, m)
    wide[:, torch.tensor(columns)] = weight
    return wide
