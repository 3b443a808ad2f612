"""The config of a run: every number it depends on, typed and checked."""

from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import pydantic
from pydantic import Field, PositiveFloat, ValidationInfo

from .. import envs
from ..envs import MorlaxError, ObjectiveOptions
from ..envs.errors import shortened, unknown, validated
from ..envs.naming import absolute, is_file
from ..envs.worlds.options import Count, Section
from ..host.phases import phase
from . import sections
from .files import algorithm_of, merged, nested, over_task_values, required_values, task_values
from .sections import Algorithm, MethodOptions, Protocol

SCALARIZATIONS = ("linear", "chebyshev", "augmented-chebyshev")
CONSTRAINED = "constrained:"  # before the name of an objective
DRAFT = "draft"  # context in which values are not checked together
# on resume
MAY_CHANGE = ("max_env_steps", "max_seconds", "target", "device", "backend", "evaluation")


class Config(Section):
    """A training run."""

    vast = ("target",)

    env: Annotated[str, pydantic.AfterValidator(absolute)]
    """The task: a name of docs/tasks.md, mjlab:TASK, a registered name,
    FILE.py:CLASS for your own, or gymnasium:ID for a Gymnasium environment with a vector reward."""
    algorithm: Algorithm = "morlax"
    """What learns the front: MORLAX, hyper-sac (few steps), or a baseline of docs/algorithms.md."""
    scalarization: str = "linear"
    """How a trade-off turns returns into one utility: linear (a weighted sum), chebyshev,
    augmented-chebyshev, constrained:OBJECTIVE (a required level of one objective), or
    FILE.py:FUNCTION for your own (docs/algorithms.md)."""
    start_from: str | None = None
    """Start with the policies of this run, which may have fewer objectives: a folder, a checkpoint
    or a shipped name."""
    seed: int = Field(default=0, ge=0, lt=2**63)
    """Random seed."""
    device: str | None = None
    """cuda, cuda:1, cpu, ... (None: CUDA if there is a GPU)."""
    backend: Literal["warp", "mujoco"] | None = None
    """MuJoCo Warp or C MuJoCo (None: Warp on CUDA, C MuJoCo on the CPU)."""
    deterministic: bool = False
    """Make MuJoCo Warp order contacts and constraints alike in every run, at some cost in speed.
    CUDA runs then repeat closely, though not bit for bit. CPU runs that end by steps repeat bit for
    bit, with the same number of threads."""
    worlds: int = Field(default=4096, gt=0, lt=2**31)
    """N, the number of parallel worlds."""
    horizon: Count = 20
    """T, control steps per world and iteration."""
    max_env_steps: int | None = Field(default=None, gt=0, lt=2**63)
    """Stop after this many environment steps."""
    max_seconds: PositiveFloat | None = None
    """Stop after this much training time, without compiling and evaluating, in seconds. With
    decay_fraction, runs then depend on how fast the machine is."""
    target: PositiveFloat | None = None
    """Hypervolume to reach: a line beside the curve in TensorBoard (None: no line)."""
    decay_fraction: float = Field(default=0.0, ge=0, le=1)
    """Share of the run, at its end, over which learning rates, desired KL, entropy bonus and
    observation normalizer updates decay linearly to zero. Until then they stay constant, as in
    warmup-stable-decay schedules (1: decay over the whole run; 0: never)."""
    sampling: sections.SamplingConfig = sections.SamplingConfig()
    network: sections.NetworkConfig = sections.NetworkConfig()
    ppo: sections.PPOConfig = sections.PPOConfig()
    evaluation: sections.EvaluationConfig = sections.EvaluationConfig()
    method: MethodOptions = MethodOptions()
    """Options of the algorithm."""
    task: ObjectiveOptions
    """Options of the task."""

    @pydantic.field_validator("start_from")
    @classmethod
    def _from_any_folder(cls, run: str | None) -> str | None:
        return str(Path(run).absolute()) if run and Path(run).exists() else run

    @pydantic.field_validator("scalarization")
    @classmethod
    def _known(cls, name: str) -> str:
        special = is_file(name) or name.startswith(CONSTRAINED)
        if not special and name not in SCALARIZATIONS:
            others = {f"{CONSTRAINED}OBJECTIVE", "FILE.py:FUNCTION"}
            raise unknown("scalarization", name, {*SCALARIZATIONS, *others})
        return absolute(name)

    def __reduce__(self) -> tuple[Any, ...]:
        # `config_class` makes its class, which pickle cannot find by name
        return load_config, (self.model_dump(),)

    @property
    def fitting_target(self) -> float | None:
        """The target: a user's, or the task's unless returns are counted in another way."""
        names = changed(self.model_dump(mode="json"))
        options = {name.split(".")[1] for name in names if name.startswith("task.")}
        other = options - {*self.task.training_only} or self.evaluation.protocol == "discounted"
        return None if other and "target" not in names else self.target

    @property
    def num_clusters(self) -> int:
        """K."""
        return self.worlds if self.sampling.mode == "dense" else self.sampling.clusters

    def with_task(self, **options: Any) -> Self:
        """Return this config with other options of the task, which are not checked."""
        return self.model_copy(update={"task": self.task.model_copy(update=options)})

    def make_worlds(self, number: int, seed: int, evaluating: bool = False) -> "envs.Worlds":
        """Make worlds of the task; those to evaluate in have no automatic reset."""
        phase(f"building {number} worlds")
        task = self.task.for_evaluation() if evaluating else self.task
        return envs.make(
            self.env,
            number,
            self.device,
            self.backend,
            seed,
            auto_reset=not evaluating,
            deterministic=self.deterministic,
            **task.model_dump(),
        )

    def num_corners(self, num_objectives: int) -> int:
        if self.sampling.mode == "dense":
            return 0
        corners = self.sampling.corners
        return num_objectives if corners is None else corners

    @pydantic.model_validator(mode="after")
    def _consistent(self, info: ValidationInfo) -> Self:
        if info.context == DRAFT:
            return self
        self._check_algorithm()
        self._check_scalarization()
        self._check_sizes()
        self.check_protocol(self.evaluation.protocol)
        limited = {
            "decay_fraction": self.decay_fraction,
            "sampling.focus": self.sampling.focus,
            f"algorithm {self.algorithm}": self.algorithm == "hyper-morl",
        }
        endless = self.max_env_steps is None and self.max_seconds is None
        for name in (name for name, used in limited.items() if used and endless):
            raise ValueError(f"{name} needs max_env_steps or max_seconds: it takes a share of them")
        return self

    def _check_algorithm(self) -> None:
        required = flat(required_values(self.algorithm))
        for name, value in required.items():
            if (typed := attrgetter(name)(self)) != value:
                raise ValueError(
                    f"{name} is {typed}, but algorithm {self.algorithm} needs {value}: leave it out"
                )
        if self.network.type == "independent" and "network.type" not in required:
            raise ValueError("network.type independent needs algorithm independent")
        if self.network.asymmetry and not self.network.symmetric:
            raise ValueError(
                "network.asymmetry needs network.symmetric: set that too, or network.asymmetry to 0"
            )
        if self.sampling.designs and self.algorithm not in sections.DESIGNING:
            raise ValueError(
                f"algorithm {self.algorithm} cannot train with many bodies: set sampling.designs "
                f"to 0, or use {' or '.join(sections.DESIGNING)}"
            )

    def _check_scalarization(self) -> None:
        name = self.scalarization
        if name == "linear":
            return
        objective = name.removeprefix(CONSTRAINED)
        if name.startswith(CONSTRAINED) and objective not in self.task.objectives:
            raise unknown("objective", objective, self.task.objectives)
        if self.ppo.critic == "scalar":
            raise ValueError(f"scalarization {name} needs ppo.critic vector")
        if self.method.off_policy:
            raise ValueError(
                f"algorithm {self.algorithm} needs weighted sums: leave out scalarization"
            )

    def check_protocol(self, protocol: Protocol) -> None:
        """Raise MorlaxError if the task's worlds cannot be evaluated by a protocol."""
        if protocol not in get_args(Protocol):  # from Python
            raise unknown("protocol", protocol, get_args(Protocol))
        if protocol == "paper" and not envs.get(self.env).may_recover:
            raise MorlaxError(
                "the protocol paper goes on after a failure, but episodes of "
                f"{shortened(self.env)} end there: choose another protocol."
            )

    def _check_sizes(self) -> None:
        m, K = len(self.task.objectives), self.num_clusters
        corners, focus = self.num_corners(m), self.sampling.focus
        if self.worlds % K:
            raise ValueError(
                f"sampling.clusters ({K}) must divide worlds ({self.worlds}): "
                f"try --worlds {self.worlds // K * K or K}"
            )
        if corners not in (0, m):
            raise ValueError(
                f"sampling.corners is {corners}: with {m} objectives it must be 0 or {m}"
            )
        if corners > K:
            raise ValueError(
                f"sampling.clusters ({K}) is less than the {corners} corners: raise it, or set "
                "sampling.corners to 0"
            )
        if focus and (len(focus) != m + 1 or not any(focus[:-1]) or not 0 < focus[-1] <= 1):
            raise ValueError(
                f"sampling.focus is {focus}: give one weight for each of the {m} objectives, at "
                "least one above zero, and then a share of training up to 1"
            )
        self.task.check_seeds(self.evaluation.seeds)
        if isinstance(self.method, sections.HyperSACOptions) and self.method.batch % K:
            batch = self.method.batch
            raise ValueError(
                f"method.batch ({batch}) must be a multiple of {K} (sampling.clusters): "
                f"try --method.batch {max(1, batch // K) * K}"
            )
        dealt = self.worlds if self.sampling.mode == "dense" else self.worlds // K
        if not self.method.off_policy and dealt % self.ppo.minibatches:
            raise ValueError(
                f"ppo.minibatches ({self.ppo.minibatches}) must divide the {dealt} worlds of a "
                f"cluster ({self.worlds} worlds / {K} clusters)"
            )


def config_class(env: str, algorithm: str = "morlax") -> type[Config]:
    """Return `Config` with the options of one task and one algorithm, so that they are checked."""
    return _with_options(envs.get(env).Options, sections.OPTIONS.get(algorithm, MethodOptions))


@cache
def _with_options(task: type[ObjectiveOptions], method: type[MethodOptions]) -> type[Config]:
    return pydantic.create_model(
        "Config", __base__=Config, method=(method, method()), task=(task, task.model_validate({}))
    )


def load_config(values: dict[str, Any], context: str | None = None) -> Config:
    """Check nested plain values, as in a YAML file, and return them as a config.

    In the context `DRAFT`, each value is checked on its own, not whether they fit together. In the
    context `STORED`, unknown keys may be null.
    """
    if not isinstance(values.get("env"), str):
        raise MorlaxError(f"the config names no task: add a line such as env: {envs.names()[0]}.")
    return validated(config_class(values["env"], algorithm_of(values)), values, context=context)


def config_for(env: str, **changes: Any) -> Config:
    """Return a task's tuned config with changes, named as on the command line.

        config_for("ant", worlds=1024, **{"ppo.learning_rate": 1e-3})

    Args:
        env: the task, as for `envs.make`.
        changes: values by name, dotted for nested ones; a dict replaces part of a section.
            `device` also selects the values for the CPU or for CUDA, `algorithm` those that the
            algorithm needs.

    Raises:
        MorlaxError: an unknown task or key, a wrong type or a combination that cannot work.
    """
    device_type = envs.resolve_device(changes.get("device")).type
    values: dict[str, Any] = {}
    for name, value in changes.items():
        values = merged(values, nested(name, value))
    return load_config(over_task_values(env, values, device_type))


def check_resumable(one: Config, other: Config, mistake: str, remedy: str) -> None:
    """Raise MorlaxError if a resumed run may not change from one config to the other."""
    values, others = flat(one.model_dump(mode="json")), flat(other.model_dump(mode="json"))
    changes = [
        f"{key}: {others.get(key)} instead of {values.get(key)}"
        for key in {**values, **others}
        if key.split(".")[0] not in MAY_CHANGE and values.get(key) != others.get(key)
    ]
    if changes:
        raise MorlaxError(
            f"{mistake} ({'; '.join(changes)}): {remedy}. A resumed run may change only "
            f"{', '.join(MAY_CHANGE)}."
        )


def changed(values: dict[str, Any]) -> set[str]:
    """Return the dotted names of a run's values that are not those of its task and algorithm.

    Where the run was trained, its device and simulator, does not count.
    """
    env, algorithm = values["env"], algorithm_of(values)
    # not validated: a run may have changed the very value that does not fit its own
    defaults = config_class(env, algorithm).model_construct().model_dump(mode="json")
    # the device of the run, which this machine may lack
    device_type = (values["device"] or envs.resolve_device(None).type).partition(":")[0]
    usual = flat(merged(defaults, task_values(env, device_type, algorithm)))
    names = {name for name, value in flat(values).items() if usual.get(name) != value}
    return names - {"device", "backend"}


def flat(values: dict[str, Any]) -> dict[str, Any]:
    """Return nested values by dotted name."""
    by_name = {}
    for key, value in values.items():
        parts = flat(value) if isinstance(value, dict) else {}
        by_name |= {f"{key}.{name}": part for name, part in parts.items()} or {key: value}
    return by_name
