"""The sections of a config, each with its numbers."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt

from ..envs.worlds.options import Count, Section

Algorithm = Literal["morlax", "hyper-sac", "amor", "hyper-morl", "independent", "rsl-rl"]
MIN_STD = 1e-3  # smallest standard deviation of pre-tanh actions
DECAYS, EPSILON = (0.9, 0.999), 1e-8  # of Adam's moments, per step; keeps its steps finite

Width = Annotated[int, Field(ge=1, le=65536)]
Layers = Annotated[tuple[Width, ...], Field(max_length=16)]
Protocol = Literal["latched", "paper", "discounted"]  # of evaluations, see `Evaluator`


class SamplingConfig(Section):
    """Which trade-offs an iteration explores."""

    mode: Literal["sparse", "dense"] = "sparse"
    """sparse: K clusters of worlds share a trade-off each; dense: every world has its own."""
    clusters: int = Field(default=8, ge=2)
    """K, for sparse sampling; must divide the number of worlds."""
    corners: NonNegativeInt | None = None
    """Number of clusters whose trade-off is a corner: 0 or one per objective (None: the latter)."""
    alpha: float = Field(default=1.0, ge=1e-3, le=1e6)
    """Concentration of the Dirichlet distribution; 1 is uniform on the simplex."""
    cells: bool = False
    """Draw each trade-off beside the corners from its own cell of an even grid, not from that
    distribution: evenly, with more samples near the corners. Has no effect with dense sampling, or
    fewer such trade-offs than objectives."""
    designs: Annotated[int, Field(ge=0, le=100_000)] = 0
    """Number of bodies to train with, of robots with design parameters; each cluster has one for an
    episode's length (0: the one body of task.design)."""
    focus: tuple[NonNegativeFloat, ...] | None = None
    """Trade-off that training starts with, and the share of training after which all trade-offs are
    sampled, such as 0 0 1 0.5: until then, samples spread from it (None: all from the start)."""


class NetworkConfig(Section):
    """The networks of all trade-offs: hypernetworks and what they generate, or conditioned ones."""

    scale: ClassVar[float] = 0.0  # the affine map starts uniform in [-scale, scale]

    type: Literal["dual", "single", "conditioned", "independent"] = "dual"
    """dual: actor and critic have separate hypernetworks; single: they share its features;
    conditioned: no hypernetworks, the trade-off is an input of actor and critic; independent:
    separate networks for each of K trade-offs."""
    hidden: Layers = (128, 128)
    """Hidden layers of the hypernetworks' feature networks."""
    features: Width = 16
    """F, the number of features that generated parameters are affine in."""
    actor: Layers = (64, 64)
    """Hidden layers of the generated actors."""
    critic: Layers = (64, 64)
    """Hidden layers of the generated critics."""
    initial_std: float = Field(default=math.log(2) + MIN_STD, gt=MIN_STD, le=100)
    """Initial standard deviation of pre-tanh actions, before network.max_std lowers it."""
    max_std: float | None = Field(default=None, gt=MIN_STD, le=100)
    """Smooth limit of the standard deviation (None: no limit). A small one keeps policies from
    gambling between two behaviors, which concave fronts reward."""
    symmetric: bool = False
    """Answer mirrored observations by mirrored actions, and give them the same value; for
    left-right symmetric robots."""
    symmetry_tolerance: float = Field(default=0.0, ge=0, le=1)
    """Largest difference between left and right of the robot's model that network.symmetric
    accepts, as a share of the largest such number of the robot (0: none, apart from rounding)."""
    asymmetry: float = Field(default=0.0, ge=0, le=1)
    """How far answers may be from symmetric ones with network.symmetric: 0 not at all, 1 as far as
    without. A robot that starts exactly symmetric needs some, such as 0.3, for its first step."""
    output_scale: float = Field(default=1.0, ge=0, le=100)
    """Factor on the initial weights of the actors' output layer: a small one starts from actions
    close to zero."""


class PPOConfig(Section):
    """How PPO updates the hypernetworks."""

    value_coefficient: ClassVar[float] = 0.5  # weight of the value loss
    max_grad_norm: ClassVar[float] = 1.0  # of the actor's gradient, and of the critic's

    learning_rate: float = Field(default=3e-4, gt=0, le=1)
    """Learning rate of Adam."""
    critic_learning_rate: float | None = Field(default=None, gt=0, le=1)
    """Learning rate of the critic (None: the same), if it has its own optimizer."""
    desired_kl: float | None = Field(default=None, gt=0, le=1)
    """After every minibatch, change the actor's learning rate towards this KL divergence between
    the policies that acted and the current ones (None: leave the learning rate)."""
    epochs: Count = 4
    """Passes over a rollout."""
    minibatches: Count = 8
    """Minibatches per pass; must divide the worlds of a cluster (dense sampling: all worlds)."""
    discount: float = Field(default=0.99, ge=0, le=1)
    """Discount factor gamma, per control step."""
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    """Lambda of generalized advantage estimation."""
    clip: float = Field(default=0.2, gt=0, le=100)
    """Clip range of the probability ratio."""
    entropy: NonNegativeFloat = 0.01
    """Weight of the entropy bonus."""
    mean_penalty: NonNegativeFloat = 0.0
    """Weight of a penalty on squared pre-tanh means, which avoids the flat ends of the tanh."""
    critic: Literal["vector", "scalar"] = "vector"
    """vector: critics predict one value per objective, and the trade-off weighs the advantages;
    scalar: they predict one value, of the rewards weighed by the trade-off."""
    optimizer: Literal["separate", "joint"] = "separate"
    """separate: actor and critic have their own Adam and gradient norm; joint: one of both for the
    sum of their losses, as a single hypernetwork always has."""
    normalize_advantages: Literal["batch", "cluster"] = "batch"
    """Normalize advantages over all trade-offs together, or within each cluster."""
    truncation: Literal["bootstrap", "mask"] = "bootstrap"
    """At a time limit, bootstrap from the value of the last state, or mask the step out."""


class EvaluationConfig(Section):
    """How fronts are evaluated while training."""

    every: int | None = Field(default=None, gt=0, lt=2**63)
    """Environment steps between evaluations (None: spaced so that they take at most about 8 % of
    the time)."""
    protocol: Protocol = "latched"
    """How returns are counted (docs/evaluation.md). latched: up to and including the first failed
    step; paper: as in the paper's tables; discounted: as in the tables of C-MORL and D3PO."""
    tradeoffs: int = Field(default=512, ge=2, le=1_000_000)
    """Number of trade-offs to evaluate: an even grid for two objectives; the corners and fixed
    random draws for more; with another protocol than latched, random draws."""
    seeds: int = Field(default=1, ge=1, le=100_000)
    """Episodes per trade-off, to average over; for tasks with random starts, models or commands.
    Such tasks pick the best checkpoint on a second set of episodes of the same size."""
    designs: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of bodies to evaluate with, if sampling.designs is not 0: that of task.design, and
    others that training may not have seen. Indicators are means over them."""


class MethodOptions(Section):
    """Options of an algorithm that has none of its own."""

    off_policy: ClassVar[bool] = False  # critics value a state and an action, twice


class RslRlOptions(MethodOptions):
    """Options of the networks of `ParetoPPO`."""

    activation: Annotated[str, Field(pattern=r"^\w+$")] = "ELU"
    """Class of torch.nn of the actors' activations."""


class HyperSACOptions(MethodOptions):
    """Options of hyper-sac."""

    off_policy: ClassVar[bool] = True
    start: ClassVar[int] = 5_000  # transitions to store before the first gradient step
    target_rate: ClassVar[float] = 0.01  # step of the target critics, per gradient step
    steps: ClassVar[int] = 3  # rewards of a target before the value of the state that follows
    temperature: ClassVar[float] = 0.02  # initial weight of the entropy, for scaled rewards
    updates: Count = 128
    """Gradient steps per iteration."""
    batch: Count = 1024
    """Transitions of a gradient step; must be a multiple of sampling.clusters."""
    replay: int = Field(default=500_000, gt=0, lt=2**40)
    """Number of transitions to keep, of all worlds of a process."""
    learning_rate: float = Field(default=7e-4, gt=0, le=1)
    """Learning rate of Adam."""
    discount: float = Field(default=0.99, ge=0, le=1)
    """Discount factor gamma, per control step."""
    entropy: float = Field(default=-0.5, ge=-100, le=100)
    """Entropy per action that the temperature aims at."""
    hold: float = Field(default=0.02, ge=0, le=100)
    """Mean time in seconds for which a world explores with the same noise, where control steps are
    shorter."""


OPTIONS: dict[str, type[MethodOptions]] = {  # of algorithms that have some
    "hyper-sac": HyperSACOptions,
    "rsl-rl": RslRlOptions,
}
DESIGNING = ("morlax", "amor")  # algorithms that train with many bodies
