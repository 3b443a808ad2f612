"""Find runs and checkpoints, load or save their policies, or start from them."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from .. import envs
from ..algorithms.learner import Learner
from ..envs import MorlaxError, resolve_device
from ..envs.errors import LONGEST
from ..host.files import AnyPath, exists, is_file, is_folder
from ..networks.agent import Sizes, agent_class
from ..networks.hypernetwork import Hypernetwork
from ..networks.policy import Policy
from . import checkpoint, models
from .contents import POLICY
from .references import NAMES_CODE, check_moved, edited, localized, name_task, trust_code

SHIPPED = Path(__file__).parent.parent / "shipped"
FIRST_LAYER = "actor.features.0.weight"  # (hidden, m)
CRITIC = ("critic.", "value_normalizer.")


def find_run(run: AnyPath) -> Path:
    """Return the folder of a run, given its path, one of its checkpoints, or a shipped name.

    A folder of runs, such as runs/ant, stands for its newest run, and "latest" for the newest of
    all in runs/. A folder with a shipped name is only meant if it is a run, not an export of it.

    Raises:
        MorlaxError: there is no such run.
    """
    path = checkpoint.named_run(run)
    if is_file(path):
        return checkpoint.folder_of(path)
    shipped = {folder.name: folder for folder in SHIPPED.glob("*")}
    found = shipped.get(str(path))
    is_run = exists(path / "config.yaml") or exists(path / "checkpoints")
    if is_folder(path) and (found is None or is_run):
        return path
    if found is not None:
        return found
    raise MorlaxError(
        f"{path} does not exist: name the folder of a run, such as runs/ant/..., a .pt file, or a "
        f"shipped policy: {', '.join(sorted(shipped))}."
    )


def own_folder(run: AnyPath) -> Path | None:
    """Return the folder of a run, to write into; None if it is a shipped policy."""
    folder = find_run(run)
    return None if folder.parent == SHIPPED else folder


def find_checkpoint(run: AnyPath) -> Path:
    """Return the best checkpoint of a run or shipped policy, or the checkpoint file itself.

    Raises:
        MorlaxError: there is no such run, or it has no checkpoint.
    """
    if is_file(run):
        return Path(run)
    folder = find_run(run)
    for name in ("best", "latest"):
        candidate = folder / "checkpoints" / f"{name}.pt"
        if candidate.is_file():
            return candidate
    raise MorlaxError(
        f"{folder} has no checkpoints: name the folder of a run, such as runs/ant/..., or a .pt."
    )


def load(
    run: AnyPath,
    device: str | torch.device | None = "cpu",
    actor: nn.Module | None = None,
    *,
    trust: bool = False,
    env: str | None = None,
) -> Policy:
    """Load the policies of a run's folder, a checkpoint file, or a shipped name ("ant").

    Args:
        run: the policies.
        device: "cpu", "cuda", ...; None selects CUDA if there is a GPU.
        actor: a module like the user-made actor of the run; its parameters do not matter.
        trust: allow the code that the checkpoint names: the FILE.py or module of its task, and the
            FILE.py of its scalarization.
        env: FILE.py:CLASS of the task, where it is now; its code is trusted, too.

    Raises:
        MorlaxError: there is no checkpoint, it is damaged, it has another actor, or it names code
            that is not trusted.
    """
    place = resolve_device(device)
    path = find_checkpoint(run)
    contents = checkpoint.load(path)
    config = checkpoint.read_config(contents, path, trust, env)
    task = contents.environment
    agent = agent_class(config)(config, Sizes.of(task), actor=actor)
    own = dict(contents.own_networks)
    own_critic = own.pop("critic", None)
    checkpoint.check_networks(own, agent.own_networks(), path)
    whole, state = contents.policy is None, contents.agent
    if own_critic:  # policies do not need it
        state = {name: value for name, value in state.items() if not name.startswith("critic.")}
    try:
        agent.load_state_dict(state, strict=whole and not own_critic)
    except RuntimeError as error:
        reason = " ".join(str(error).split())[:LONGEST]
        raise MorlaxError(f"the networks in {path} do not fit its config: {reason}.") from None
    policy = Policy(agent.to(place), config, task.objectives)
    policy.model_fingerprint = task.model_fingerprint
    models.warn(_model_difference(policy), path)
    return policy


def _model_difference(policy: Policy) -> str:
    """Return in which parts the model is not the one that a policy was trained with, or ""."""
    stored, config = dict(policy.model_fingerprint), policy.config
    if not stored:
        return ""
    return models.difference(stored, models.of_task(envs.get(config.env), config.task))


def is_changed(run: AnyPath, policy: Policy) -> bool:
    """Return whether the task of a run's policy has changed since it was trained, if known."""
    copies = checkpoint.folder_of(find_checkpoint(run)) / NAMES_CODE["env"]
    return bool(_model_difference(policy) or edited(policy.config.env, copies.resolve()))


def objectives_of(run: AnyPath) -> tuple[str, ...]:
    """Return the objectives of a run from its checkpoint, without importing its task."""
    return checkpoint.load(find_checkpoint(run)).environment.objectives


def trust_run(run: AnyPath, trust: bool = True, env: str | None = None) -> None:
    """Allow runs to name the code that this run names, in this process, if `trust`.

    `env`: FILE.py:CLASS of the run's task, where it is now, from now on.

    Raises:
        MorlaxError: there is no such run, or its task is another one.
    """
    if not trust and env is None:
        return
    path = find_checkpoint(run)
    config, folder = checkpoint.load(path).config, checkpoint.folder_of(path)
    if env is not None:
        check_moved(config["env"], env, path)
        name_task(folder, env)
    if trust:
        trust_code(localized(config, folder))


def save(policy: Policy, path: AnyPath) -> None:
    """Write a checkpoint that `load` reads, without critic, optimizers and worlds.

    Raises:
        MorlaxError: the file cannot be written.
    """
    state, own = policy.agent.state_dict(), policy.agent.own_networks()
    own.pop("critic", None)
    contents = {
        "config": policy.config.model_dump(mode="json"),
        "environment": {
            "objectives": list(policy.objectives),
            "observation_size": policy.agent.observation_size,
            "action_size": policy.agent.action_size,
            "privileged_size": policy.agent.privileged_size,
            "designs": {name: list(each) for name, each in policy.agent.designs.items()},
            "model_fingerprint": dict(policy.model_fingerprint),
        },
        "own_networks": own,
        "policy": {name: value for name, value in state.items() if name.startswith(POLICY)},
    }
    checkpoint.write(path, contents)


def start_from(run: str, learner: Learner) -> None:
    """Copy another run's actor and observation normalizer into `learner`, in place.

    The learner may have designs although the run has one body: all bodies start with its policies.
    The learner may have objectives that the run lacks. The policy of a trade-off is then the run's
    policy for the weights of the run's own objectives, each plus an even share of the weights of
    the others, and the critic starts anew. With the same objectives, a critic of the same size is
    copied too. All processes of the learner's group must call it; they start with what the first
    one read.

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
    contexts = len(agent.context)
    state[FIRST_LAYER] = _widened(state[FIRST_LAYER], len(objectives), columns, contexts)
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


def _widened(weight: Tensor, m: int, columns: list[int], contexts: int) -> Tensor:
    """Return the weights (hidden, m + d) of m trade-off inputs, of which `columns` are known.

    The others get the mean, because the first layer then maps their corners to the same features
    as the even trade-off of the known objectives. The d inputs of `contexts` get zeros, unless
    their weights are known too.
    """
    weight, known = weight.split([len(columns), weight.shape[1] - len(columns)], 1)
    wide = weight.mean(1, keepdim=True).repeat(1, m)
    wide[:, torch.tensor(columns)] = weight
    return torch.cat([wide, known if known.shape[1] else wide.new_zeros(len(wide), contexts)], 1)
