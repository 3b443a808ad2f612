"""Every number that a run depends on, typed and checked."""

import math
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

import yaml
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    create_model,
    field_validator,
    model_validator,
)

from . import envs
from .envs import MorlaxError, ObjectiveOptions


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class SamplingConfig(Section):
    """Which trade-offs an iteration explores."""

    mode: Literal["sparse", "dense"] = "sparse"
    """sparse: K clusters of worlds share a trade-off each; dense: every world has its own."""
    clusters: int = 8
    """K, for sparse sampling; it divides the number of worlds."""
    corners: NonNegativeInt | None = None
    """How many clusters are corners: 0, or one for each objective (None: one for each)."""
    alpha: PositiveFloat = 1.0
    """Of the Dirichlet distribution; 1 is uniform on the simplex."""


class NetworkConfig(Section):
    """The hypernetworks and the networks they generate."""

    type: Literal["dual", "single"] = "dual"
    """dual: actor and critic have a hypernetwork each; single: they share its features."""
    hidden: tuple[PositiveInt, ...] = (128, 128)
    """Hidden layers of the hypernetworks' feature networks."""
    features: PositiveInt = 16
    """F, how many features the parameters are affine in."""
    scale: NonNegativeFloat = 0.0
    """The affine map starts uniform within this distance of zero."""
    actor: tuple[PositiveInt, ...] = (64, 64)
    """Hidden layers of the generated actors."""
    critic: tuple[PositiveInt, ...] = (64, 64)
    """Hidden layers of the generated critics."""
    initial_std: float = Field(default=math.log(2) + 0.001, gt=0.001)
    """Of the actions before the tanh, about which the actors begin to explore."""


class PPOConfig(Section):
    """How the hypernetworks learn from a rollout."""

    learning_rate: PositiveFloat = 3e-4
    """Adam's step size."""
    critic_learning_rate: PositiveFloat | None = None
    """Adam's step size for the critic (None: the same)."""
    anneal: bool = False
    """Let step sizes, the entropy's weight and the weight of new observations in what normalises
    them fall linearly, to nothing at max_env_steps (which, changed when a run is resumed, moves
    that end)."""
    epochs: PositiveInt = 4
    """Passes over a rollout."""
    minibatches: PositiveInt = 8
    """Updates per pass; it divides the worlds of a cluster (dense sampling: the worlds)."""
    discount: float = Field(default=0.99, ge=0, le=1)
    """What a reward one step later is worth."""
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    """How far advantages look before they trust the critic."""
    clip: PositiveFloat = 0.2
    """How far a probability ratio may move before it stops counting."""
    entropy: NonNegativeFloat = 0.01
    """Weight of the entropy in the policy's objective."""
    mean_penalty: NonNegativeFloat = 0.0
    """Weight of the squared means of actions before the tanh in the policy's loss: it keeps them
    from where the tanh is flat and exploring moves nothing."""
    value_coefficient: PositiveFloat = 0.5
    """Weight of the critic's squared error."""
    max_grad_norm: PositiveFloat = 1.0
    """Gradients are scaled down to this norm, actor and critic apart."""
    normalize_values: bool = True
    """Let the critic learn targets scaled by their running mean and variance."""
    truncation: Literal["bootstrap", "mask"] = "bootstrap"
    """At a time limit: trust the critic's value of the last state, or leave the step out."""


class EvaluationConfig(Section):
    """How the front is measured while training."""

    every: PositiveInt = 2_000_000
    """Environment steps between evaluations."""
    tradeoffs: int = Field(default=512, ge=2)
    """How many fixed trade-offs are judged, an episode each."""


class Config(Section):
    """A training run."""

    env: str
    """The task: ant, cheetah, cheetah3, hopper, humanoid, walker, any other of docs/tasks.md, a
    registered name, FILE.py:CLASS for one of your own, or gymnasium:ID for an environment of
    Gymnasium's with a vector of rewards."""
    seed: NonNegativeInt = 0
    """Of everything that is drawn at random."""
    device: str | None = None
    """cuda, cuda:1, cpu, ... (None: CUDA where there is one)."""
    backend: Literal["warp", "mujoco"] | None = None
    """MuJoCo Warp or C MuJoCo (None: Warp on CUDA, C MuJoCo on the CPU)."""
    deterministic: bool = False
    """Let MuJoCo Warp order contacts and constraints alike in every run, at some cost in speed;
    on CUDA runs then repeat closely, though not bit for bit. On the CPU runs always repeat."""
    worlds: int = Field(default=4096, gt=0, lt=2**31)
    """N, how many copies of the robot run at once."""
    horizon: PositiveInt = 20
    """T, steps of each world per iteration."""
    max_env_steps: PositiveInt | None = None
    """Stop after this many environment steps."""
    max_seconds: PositiveFloat | None = None
    """Stop after this much training time: compiling and evaluating do not count."""
    sampling: SamplingConfig = SamplingConfig()
    network: NetworkConfig = NetworkConfig()
    ppo: PPOConfig = PPOConfig()
    evaluation: EvaluationConfig = EvaluationConfig()
    task: ObjectiveOptions
    """Options of the task itself."""

    @field_validator("env")
    @classmethod
    def _for_any_folder(cls, env: str) -> str:
        return envs.absolute(env)

    @property
    def num_clusters(self) -> int:
        """K."""
        return self.worlds if self.sampling.mode == "dense" else self.sampling.clusters

    def num_corners(self, num_objectives: int) -> int:
        """How many of the K trade-offs are corners."""
        if self.sampling.mode == "dense":
            return 0
        corners = self.sampling.corners
        return num_objectives if corners is None else corners

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self.check_sizes(len(self.task.objectives))
        return self

    def check_sizes(self, num_objectives: int) -> None:
        """Raise ValueError if the sizes do not fit together."""
        K, corners = self.num_clusters, self.num_corners(num_objectives)
        if K <= 1:
            raise ValueError(f"sampling.clusters is {K}: there must be at least 2 trade-offs")
        if self.worlds % K:
            raise ValueError(
                f"sampling.clusters ({K}) must divide worlds ({self.worlds}): "
                f"try --worlds {self.worlds // K * K or K}"
            )
        if corners not in (0, num_objectives):
            raise ValueError(
                f"sampling.corners is {corners}: with {num_objectives} objectives it must be "
                f"0 or {num_objectives}"
            )
        if corners > K:
            raise ValueError(f"sampling.clusters ({K}) is less than the {corners} corners")
        if self.ppo.anneal and self.max_env_steps is None:
            raise ValueError("ppo.anneal needs max_env_steps: it says when to arrive at nothing")
        if self.evaluation.tradeoffs < num_objectives:
            raise ValueError(
                f"evaluation.tradeoffs is {self.evaluation.tradeoffs}: it takes at least one for "
                f"each of the {num_objectives} objectives"
            )
        dealt = self.worlds if self.sampling.mode == "dense" else self.worlds // K
        if dealt % self.ppo.minibatches:
            raise ValueError(
                f"ppo.minibatches ({self.ppo.minibatches}) must divide the {dealt} worlds of a "
                f"cluster ({self.worlds} worlds / {K} clusters)"
            )


def config_class(env: str) -> type[Config]:
    """`Config` with the options of one task, so that they too are typed and checked."""
    return _with_options(envs.get(env).Options)


@cache
def _with_options(options: type[ObjectiveOptions]) -> type[Config]:
    return create_model("Config", __base__=Config, task=(options, options.model_validate({})))


def load_config(values: dict[str, Any]) -> Config:
    """A checked config from nested plain values, as a YAML file holds them.

    Raises:
        MorlaxError: an unknown key, a wrong type or a combination that cannot work.
    """
    if not isinstance(values.get("env"), str):
        raise MorlaxError(f"the config names no environment: add env: {envs.names()[0]}.")
    model = config_class(values["env"])
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise envs.explained(error, model) from None


def task_values(env: str, device_type: str) -> dict[str, Any]:
    """The values of configs/<env>.yaml for "cuda" or "cpu"; without such a file, of default.yaml.

    All of "gymnasium:ID" share configs/gymnasium.yaml.
    """
    envs.get(env)
    configs = resources.files("morlax_torch.configs")
    file = configs / f"{env.partition(':')[0]}.yaml"
    if envs.is_file(env) or not file.is_file():
        file = configs / "default.yaml"
    return {**_fitted(yaml.safe_load(file.read_text()), device_type), "env": env}


def file_values(path: Path, device_type: str) -> dict[str, Any]:
    """The values of a YAML file over those of the task that it names."""
    values = _fitted(read_yaml(path), device_type)
    if not isinstance(values.get("env"), str):
        return values
    return merged(task_values(values["env"], device_type), values)


def read_yaml(path: Path) -> dict[str, Any]:
    """The keys and values of a file.

    Raises:
        MorlaxError: it cannot be read, or holds something else.
    """
    try:
        values = yaml.safe_load(path.read_text())
    except OSError as error:
        raise MorlaxError(f"cannot read the config {path}: {error.strerror}.") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise MorlaxError(f"the config {path} is not YAML: {reason}") from None
    if not isinstance(values, dict):
        raise MorlaxError(f"the config {path} must hold keys and values, such as env: ant.")
    return values


def _fitted(values: dict[str, Any], device_type: str) -> dict[str, Any]:
    """Without the section `cpu`, which holds what differs without a GPU."""
    values = dict(values)
    cpu = values.pop("cpu", None) or {}
    return merged(values, cpu) if device_type == "cpu" else values


def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """`above` over `below`; sections merge, but groups of reward terms are replaced as a whole."""
    result = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        whole = key in ("objectives", "shared")
        result[key] = merged(result[key], value) if both and not whole else value
    return result
