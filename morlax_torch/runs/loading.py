"""Find runs; load, save, evaluate, pack and start from their policies; fronts and bookmarks."""

import math
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from torch import Tensor, nn

from .. import envs
from ..algorithms.learner import Learner
from ..configuration.files import write_record
from ..configuration.schedules import Schedule
from ..configuration.sections import Protocol, RslRlOptions
from ..configuration.tradeoffs import parse_tradeoff
from ..envs import MorlaxError, resolve_device
from ..envs.errors import LONGEST, line, unknown
from ..envs.worlds.options import PLAIN_NAME
from ..evaluation.evaluator import make_evaluator
from ..evaluation.front import Front
from ..host.files import RUNS, AnyPath, making, newest_runs, read, write_file
from ..networks.agent import Agent
from ..networks.hypernetwork import Hypernetwork
from ..networks.policy import Policy
from ..networks.unbounded import RslRlAgent
from . import checkpoint, hardware, references
from .checkpoint import POLICY, Task
from .progress import read_rows

SHIPPED = Path(__file__).parent.parent / "shipped"
FIRST_LAYER = "actor.features.0.weight"  # (hidden, m)
CRITIC = ("critic.", "value_normalizer.")
WRITING = 0.5  # s that training may take between two files
BOOKMARKS = "bookmarks.yaml"  # which people can edit: "calm: [0.2, 0.8]"
PLAIN: Any = {"default_flow_style": None, "sort_keys": False}  # a line for each bookmark


def named_run(run: AnyPath) -> Path:
    """Return the path that a user means: the newest run of a folder of runs, or of "latest"."""
    path = Path(run)
    latest = str(path) == "latest" and not path.exists()
    if not latest and (_is_run(path) or not path.is_dir()):
        return path
    newest = newest_runs(RUNS if latest else path)
    if latest and not newest:
        raise MorlaxError(f"there is no run in {RUNS}/ yet: train one first.")
    return newest[0] if newest else path


def _is_run(path: Path) -> bool:
    return (path / "checkpoints").exists() or (path / "config.yaml").exists()


def find_run(run: AnyPath) -> Path:
    """Return the folder of a run, given its path, one of its checkpoints, or a shipped name.

    A folder of runs, such as runs/ant, stands for its newest run, and "latest" for the newest of
    all in runs/. A folder with a shipped name is only meant if it is a run, not an export of it.
    """
    path = named_run(run)
    if path.is_file():
        return checkpoint.folder_of(path)
    shipped = {folder.name: folder for folder in SHIPPED.glob("*")}
    if path.is_dir() and (_is_run(path) or str(path) not in shipped):
        return path
    if str(path) in shipped:
        return shipped[str(path)]
    raise MorlaxError(
        f"{path} does not exist: name the folder of a run, such as runs/ant/..., a .pt file, or a "
        f"shipped policy: {', '.join(sorted(shipped))}."
    )


def own_folder(run: AnyPath) -> Path | None:
    """Return the folder of a run, to write into; None if it is a shipped policy."""
    folder = find_run(run)
    return None if folder.parent == SHIPPED else folder


def find_checkpoint(run: AnyPath) -> Path:
    """Return the best checkpoint of a run or shipped policy, or the checkpoint file itself."""
    if Path(run).is_file():
        return Path(run)
    folder = find_run(run)
    for name in ("best", "latest"):
        candidate = folder / "checkpoints" / f"{name}.pt"
        if candidate.is_file():
            return candidate
    models = {file.stem.rpartition("_")[2]: file for file in folder.glob("model_*.pt")}  # rsl_rl's
    if numbers := [number for number in models if number.isdecimal()]:
        return models[max(numbers, key=int)]
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
    device, path = resolve_device(device), find_checkpoint(run)
    trust_run(path, trust, env)
    contents = checkpoint.load(path)
    config = checkpoint.read_config(contents, path)
    task, networks = contents.environment, dict(contents.own_networks)
    make = RslRlAgent if isinstance(config.method, RslRlOptions) else Agent
    with torch.device("cpu"):  # also if scripts set another default device
        agent = make(config, task, actor=actor)
    state, complete = contents.agent, contents.policy is None
    if networks.pop("critic", None):  # a user's critic, which policies do not need
        state = {name: value for name, value in state.items() if not name.startswith("critic.")}
        complete = False
    checkpoint.check_networks(networks, agent.own_networks(), path)
    try:
        agent.load_state_dict(state, strict=complete)
    except RuntimeError as error:
        reason = line(error)[:LONGEST]
        raise MorlaxError(f"the networks in {path} do not fit its config: {reason}.") from None
    policy = Policy(agent.to(device), config, task.objectives)
    policy.model_fingerprint = task.model_fingerprint
    _has_other_model(policy, path, warn=True)
    return policy


def _has_other_model(policy: Policy, path: Path, warn: bool = False) -> bool:
    stored, config = dict(policy.model_fingerprint), policy.config
    current = references.model_of_task(envs.get(config.env), config.task) if stored else {}
    return references.check_model(stored, current, path, warn)


def is_changed(run: AnyPath, policy: Policy) -> bool:
    """Return whether the task of a run's policy has changed since it was trained, if known."""
    path = find_checkpoint(run)
    copies = checkpoint.folder_of(path) / references.NAMES_CODE["env"]
    _, changed = references.compared(policy.config.env, copies.resolve())
    return bool(changed) or _has_other_model(policy, path)


def _objectives_of(run: AnyPath) -> tuple[str, ...]:
    """Return the objectives of a run from its checkpoint, without importing its task."""
    return checkpoint.load(find_checkpoint(run)).environment.objectives


def trust_run(run: AnyPath, trust: bool = True, env: str | None = None) -> None:
    """Trust the code of a run, if `trust`; `env` is its task: FILE.py:CLASS, where it is now."""
    if not trust and env is None:
        return
    path = find_checkpoint(run)
    config, folder = checkpoint.load(path).config, checkpoint.folder_of(path)
    if env is not None:
        references.name_task(folder, config["env"], env)
    if trust:
        for name in references.code_of(references.localized(config, folder)):
            envs.trust(name)


def save(policy: Policy, path: AnyPath) -> None:
    """Write a checkpoint that `load` reads, without critic, optimizers and worlds.

    Raises:
        MorlaxError: the file cannot be written.
    """
    networks = policy.agent.own_networks()
    networks.pop("critic", None)
    state = policy.agent.state_dict().items()
    task = Task.model_validate(policy.agent, from_attributes=True)
    task.model_fingerprint = dict(policy.model_fingerprint)
    contents = {
        "config": policy.config.model_dump(mode="json"),
        "environment": task.model_dump(mode="json"),
        "own_networks": networks,
        "policy": {name: value for name, value in state if name.startswith(POLICY)},
    }
    checkpoint.write(path, contents)


def load_front(run: AnyPath) -> Front:
    """Load the front of the policies that `load` loads; its `checkpoint` names their file."""
    path = find_checkpoint(run)
    file = checkpoint.front_path(path)
    named = file.parent if file.name == "front.npz" else path  # the run of best.pt
    remedy = f"write it with morlax evaluate {shlex.quote(str(named))}"
    if not file.is_file():
        raise MorlaxError(f"{path} has no front beside it: {remedy}")
    for seconds in (WRITING, 0.0):  # training replaces a checkpoint, and then its front
        front, contents = Front.load(file), checkpoint.load(path)
        protocol = contents.config.get("evaluation", {}).get("protocol")
        policies = front.fingerprint, front.protocol
        if policies == (checkpoint.fingerprint(contents.agent), protocol):
            return front._replace(checkpoint=path.name)
        time.sleep(seconds)
    raise MorlaxError(f"{file} is of other policies than {path}, or of another protocol: {remedy}")


def evaluate(
    run: AnyPath | Policy,
    tradeoffs: int | None = None,
    protocol: Protocol | None = None,
    device: str | None = None,
    backend: str | None = None,
    seed: int = 0,
    seeds: int | None = None,
) -> Front:
    """Evaluate a run's best checkpoint, a checkpoint file, a shipped name, or a policy.

    Args:
        run: the policies; a `Policy` is moved to the device.
        tradeoffs: K, the number of trade-offs: an even grid for two objectives; the corners and
            fixed random draws for more; by another protocol than latched, random draws. None: as
            in training, or the 1,024 of published tables.
        protocol: how returns are counted, see `Evaluator`; None: as in training.
        device: "cuda", "cpu", ...; None selects CUDA if there is a GPU.
        backend: "warp" or "mujoco"; None is chosen by device.
        seed: random seed of the worlds, for tasks with random starts or models.
        seeds: episodes per trade-off, each with its own random draws, to average over; None: as in
            training.

    Raises:
        MorlaxError: there is no such run, a number is out of range, nothing in the task is random
            although `seeds` > 1, or the task cannot be evaluated by the protocol.
    """
    target = resolve_device(device)
    policy = (run if isinstance(run, Policy) else load(run, target)).to(target)
    config = policy.config.model_copy(update={"device": str(target), "backend": backend})
    evaluator = make_evaluator(policy.agent, config, protocol, tradeoffs, seeds, seed)
    evaluator.compile()
    mark = checkpoint.fingerprint(policy.agent.state_dict())
    return evaluator.evaluate()._replace(fingerprint=mark)


def front_of(run: str | Path, policy: Policy, device: str | None = None) -> Front:
    """Load the front of a run, or evaluate its `policy` if it has none."""
    path = find_checkpoint(run)
    if checkpoint.front_path(path).is_file():
        return load_front(run)
    return evaluate(policy, device=device)._replace(checkpoint=path.name)


def pack(run: str | Path, output: Path, device: str | None = None) -> Front:
    """Write the policies of a run's best checkpoint, their front, config and any training curve.

    The folder, new or empty, gets the shape of a run, so every command accepts it, but training
    cannot continue from it. Returns the front, which `device` evaluates if the run has none.
    """
    source, policy = find_run(run), load(run)
    if (curve := source / "metrics.csv").exists():
        read_rows(curve)  # refuses a damaged file
    with making(output) as draft:
        (draft / "checkpoints").mkdir()
        front = front_of(run, policy, device)._replace(checkpoint="best.pt")
        save(policy.cpu(), draft / "checkpoints" / "best.pt")
        front.save(draft / "front.npz")
        references.copy_files(policy.config, draft)
        for name in ("metrics.csv", BOOKMARKS, hardware.FILE):
            if (source / name).is_file():
                (draft / name).write_bytes(read(source / name))
        write_record(policy.config, draft)
    return front


def check_bookmark(run: AnyPath, name: str, replaces: bool = True) -> Path:
    """Return the file that keeps a bookmark, or raise MorlaxError: such as of a shipped policy."""
    if not PLAIN_NAME.fullmatch(name):
        raise MorlaxError(
            f"{name!r} cannot name a bookmark: use at most 40 letters (A-Z, a-z), digits, spaces, "
            "_ and -, and start with a letter or digit."
        )
    folder = own_folder(run)
    if folder is None:
        raise MorlaxError(f"shipped policies keep no bookmarks: first pack {run} my-{run}.")
    if name in bookmarks(run) and not replaces:  # a damaged file is refused, too
        raise MorlaxError(f"there is a bookmark {name} already: delete it first.")
    return folder / BOOKMARKS


def bookmark(run: AnyPath, name: str, tradeoff: Sequence[float], replaces: bool = True) -> Path:
    """Store a trade-off (m,), over one of this name if it `replaces` that; returns the file."""
    file = check_bookmark(run, name, replaces)
    stored = {**bookmarks(run), name: [float(weight) for weight in tradeoff]}
    write_file(file, yaml.safe_dump(stored, **PLAIN))
    return file


def rename_bookmark(run: AnyPath, name: str, new: str) -> None:
    """Give a bookmark of a run another name; an empty one removes it."""
    file = check_bookmark(run, new or name, replaces=not new)
    stored = {new if key == name else key: weights for key, weights in bookmarks(run).items()}
    stored.pop("", None)
    write_file(file, yaml.safe_dump(stored, **PLAIN))


def bookmarks(run: AnyPath) -> dict[str, list[float]]:
    """Return the trade-offs of a run by name, whose weights sum to one.

    Raises MorlaxError if their file, which people can edit, is damaged.
    """
    file = find_run(run) / BOOKMARKS
    if not file.is_file():
        return {}
    names = _objectives_of(run)
    try:
        values = yaml.safe_load(read(file, "bookmarks"))
        rows = {str(name): [*map(float, weights)] for name, weights in values.items()}
        if any(len(x) != len(names) or not 0 <= min(x) <= sum(x) < math.inf for x in rows.values()):
            raise ValueError
        return {name: [weight / math.fsum(row) for weight in row] for name, row in rows.items()}
    except (yaml.YAMLError, AttributeError, ArithmeticError, TypeError, ValueError):
        raise MorlaxError(
            f"{file} is damaged: each of its lines is a name and weights of {', '.join(names)}, "
            f"such as calm: {[round(1 / len(names), 2)] * len(names)}."
        ) from None


def tradeoff_of(text: str, run: AnyPath) -> tuple[float, ...]:
    """Parse a trade-off such as "0.8,0.2", or "@NAME" of a bookmark, or raise MorlaxError."""
    if text.startswith("@"):
        stored, name = bookmarks(run), text.removeprefix("@")
        if name not in stored:
            raise unknown(f"bookmark of {run}", name, stored)
        text = ",".join(map(repr, stored[name]))
    return parse_tradeoff(text, _objectives_of(run))


def moving_tradeoff_of(text: str, run: AnyPath) -> tuple[float, ...] | Schedule:
    """Parse a trade-off, or load FILE.yaml of one over time, or raise MorlaxError."""
    if text.endswith(".yaml"):
        return Schedule.load(text, _objectives_of(run))
    return tradeoff_of(text, run)


def start_from(run: str, learner: Learner) -> None:
    """Copy another run's actor and observation normalizer into `learner`, in place.

    All bodies of its designs start with the run's policies. If the learner has more objectives, the
    policy of a trade-off is the run's for the weights of the run's own objectives, each plus an
    even share of the others, and the critic starts anew. With the same objectives, a critic of the
    same size is copied too. All processes of the learner's group must call it.
    """
    path = find_checkpoint(run)
    contents, agent, objectives = checkpoint.load(path), learner.agent, learner.env.objectives
    before, state = contents.environment.objectives, dict(contents.agent)
    if missing := [name for name in before if name not in objectives]:
        raise MorlaxError(
            f"{path} has the objective {missing[0]}, which this run lacks: its objectives are "
            f"{', '.join(objectives)}."
        )
    if not isinstance(agent.actor, Hypernetwork) or FIRST_LAYER not in state:
        raise MorlaxError(
            f"start_from needs hypernetworks, which {path} or algorithm "
            f"{learner.config.algorithm} lacks."
        )
    columns = [objectives.index(name) for name in before]
    state[FIRST_LAYER] = _widened(state[FIRST_LAYER], columns, len(objectives), len(agent.context))
    target = agent.state_dict()
    fits = {n for n, value in target.items() if n in state and state[n].shape == value.shape}
    names = [name for name in target if name.startswith(POLICY)]
    if not fits.issuperset(names):
        raise MorlaxError(
            f"the networks in {path} have other sizes than this run's: give both the same network "
            "section and the same task."
        )
    critic = [name for name in target if name.startswith(CRITIC)]
    if tuple(before) == tuple(objectives) and fits.issuperset(critic):
        names += critic
    for name in names:
        target[name].copy_(state[name])
    learner.group.share(agent)  # a run in training may have replaced its checkpoint meanwhile


def _widened(weight: Tensor, columns: list[int], m: int, contexts: int) -> Tensor:
    weight, context = weight.tensor_split([len(columns)], 1)
    if not context.shape[1]:
        context = weight.new_zeros(len(weight), contexts)
    # with their mean, the first layer maps the corners of the other inputs to the same features as
    # the even trade-off of the objectives before
    wide = weight.mean(1, keepdim=True).repeat(1, m)
    wide[:, columns] = weight
    return torch.cat([wide, context], 1)  # (hidden, m + d)
