"""What `ParetoPPO` puts in the place of rsl_rl's models and storage, for K trade-offs.

Row r of a batch belongs to trade-off r % K, so rsl_rl's batches stay flat. Rewards, values and
returns have one column per objective.
"""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution, HeteroscedasticGaussianDistribution
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor, nn

from ..configuration.tradeoffs import even_tradeoffs
from ..envs import MorlaxError
from ..evaluation import pareto
from ..networks.hypernetwork import Hypernetwork
from ..networks.unbounded import GaussianMLP

EPISODES = 8  # worlds per trade-off of the front


class FamilyModel(MLPModel):
    """An MLPModel for every trade-off, whose parameters a hypernetwork generates.

    Args:
        obs, obs_groups, obs_set, output_dim: as for `MLPModel`.
        focus: trade-off (m,) of the warm-up, and that plays.
        features: F of the hypernetwork.
        config: further arguments of `MLPModel`.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        focus: Tensor,
        features: int,
        **config: Any,
    ):
        self._config = config
        super().__init__(obs, obs_groups, obs_set, output_dim, **copy.deepcopy(config))
        outputs = 1 if self.distribution is None else output_dim
        self._make_plain = partial(MLPModel, obs[:1], obs_groups, obs_set, outputs)
        target: nn.Module = self.mlp
        gaussian = self.distribution
        self.std_name = ""
        if type(gaussian) is GaussianDistribution:
            self.std_name = "std_param" if gaussian.std_type == "scalar" else "log_std_param"
            spread = getattr(gaussian, self.std_name)
            if spread.requires_grad:  # a standard deviation for every trade-off
                target = GaussianMLP(self.mlp, spread)
                limits: dict[str, Any] = {}
                if hasattr(gaussian, "std_range"):  # since rsl_rl 5.2
                    limits = {"std_range": gaussian.std_range}
                self.distribution = HeteroscedasticGaussianDistribution(
                    output_dim, std_type=gaussian.std_type, **limits
                )
        self.family = Hypernetwork(target, len(focus), num_features=features)
        del self.mlp  # the family has a copy
        self.focus = nn.Buffer(focus.clone(), persistent=False)  # (m,)
        # (K, m) that learn, and (1, m) or (B, m) that play
        self.tradeoffs: Tensor = nn.Buffer(focus[None].clone(), persistent=False)
        self.shown: Tensor = nn.Buffer(focus[None].clone(), persistent=False)
        self._parameters_of_rollout: dict[str, Tensor] | None = None

    def forward(
        self,
        obs: TensorDict,
        masks: Tensor | None = None,
        hidden_state: Any = None,
        stochastic_output: bool = False,
    ) -> Tensor:
        if self.training:
            output = self.run(obs, self.tradeoffs, self._parameters_of_rollout)
        else:
            output = self.run(obs, self.shown)
        if self.distribution is None:
            return output
        if stochastic_output:
            self.distribution.update(output)
            return self.distribution.sample()
        return self.distribution.deterministic_output(output)

    def run(
        self, obs: TensorDict, tradeoffs: Tensor, parameters: dict[str, Tensor] | None = None
    ) -> Tensor:
        """Return the outputs of B rows; row r is of trade-off r % K of (K, m).

        `parameters` are those of the trade-offs, if they were generated before. Batched products
        take fewer calls than `family.run`: on a GPU, rsl_rl waits for the CPU.
        """
        generated: dict[str, Tensor] = parameters or self.family(tradeoffs)
        rows = self.get_latent(obs).unflatten(0, (-1, len(tradeoffs))).transpose(0, 1)
        values = {plain_name(name, self.std_name): value for name, value in generated.items()}
        layers: Any = getattr(self.family.target, "mlp", self.family.target)
        for index, layer in enumerate(layers):
            if isinstance(layer, nn.Linear):
                weight, bias = values[f"mlp.{index}.weight"], values[f"mlp.{index}.bias"]
                rows = torch.baddbmm(bias[:, None], rows, weight.mT)
            else:
                rows = layer(rows)
        if "std" in generated:
            rows = torch.stack([rows, generated["std"][:, None].expand_as(rows)], -2)
        return rows.transpose(0, 1).flatten(0, 1)

    def begin_rollout(self, tradeoffs: Tensor) -> None:
        """Take the trade-offs (K, m) of a rollout, in which parameters do not change."""
        self.tradeoffs = tradeoffs
        self._parameters_of_rollout = self.family(tradeoffs)

    def end_rollout(self) -> None:
        self._parameters_of_rollout = None

    @torch.no_grad()
    def plain(self, tradeoff: Tensor) -> MLPModel:
        """Return the MLPModel of one trade-off (m,); a critic's values are weighted by it."""
        model = self._make_plain(**copy.deepcopy(self._config)).to(tradeoff.device).eval()
        parameters = {name: rows[0] for name, rows in self.family(tradeoff[None]).items()}
        weights = tradeoff / tradeoff.sum() if self.distribution is None else None
        model.load_state_dict(plain_state(parameters, self.std_name, weights), strict=False)
        model.obs_normalizer.load_state_dict(self.obs_normalizer.state_dict())
        return model

    @torch.no_grad()
    def start_from(self, state: Mapping[str, Tensor]) -> None:
        """Make the network of every trade-off that of a plain MLPModel's state, in place.

        Each objective's value starts as that of the whole reward.
        """
        prefix = "obs_normalizer."
        statistics = {k.removeprefix(prefix): x for k, x in state.items() if k.startswith(prefix)}
        self.obs_normalizer.load_state_dict(statistics)
        for name, values in self.family.split(self.family.bias).items():
            values.copy_(state[plain_name(name, self.std_name)])
        self.family.weight.zero_()

    def as_jit(self) -> nn.Module:
        return self.plain(self.shown[0]).as_jit()

    def as_onnx(self, verbose: bool = False) -> nn.Module:
        return self.plain(self.shown[0]).as_onnx(verbose)


def plain_state(
    parameters: Mapping[str, Tensor], std_name: str, weights: Tensor | None = None
) -> dict[str, Tensor]:
    """Return a plain MLPModel's state, without its normalizer, from one network's parameters.

    A critic's m values are weighted, by `weights` (m,).
    """
    state = {plain_name(name, std_name): value for name, value in parameters.items()}
    if weights is not None:
        for name in [*state][-2:]:  # weight and bias of the last layer
            state[name] = (weights @ state[name])[None]
    return state


def plain_name(name: str, std_name: str) -> str:
    """Return what a plain MLPModel calls a parameter of a family."""
    if name == "std":
        return f"distribution.{std_name}"
    return name if name.startswith("mlp.") else f"mlp.{name}"


class FamilyStorage(RolloutStorage):
    """A rollout of rows of K trade-offs, with m rewards, values and returns each."""

    def __init__(self, m: int, tradeoffs: int, *args: Any):
        super().__init__(*args)
        self.tradeoffs = tradeoffs
        shape = self.num_transitions_per_env, self.num_envs, m
        self.rewards, self.values, self.returns = (
            torch.zeros(shape, dtype=torch.float32, device=self.device) for _ in range(3)
        )

    def add_transition(self, transition: RolloutStorage.Transition) -> None:
        step, rewards = self.step, transition.rewards
        assert rewards is not None
        transition.rewards = rewards[:, 0]  # it takes one number per row, which is replaced
        super().add_transition(transition)
        self.rewards[step] = rewards

    def mini_batch_generator(
        self, num_mini_batches: int, num_epochs: int = 8
    ) -> Iterator[RolloutStorage.Batch]:
        """Yield shuffled minibatches, in which row r still belongs to trade-off r % K."""
        names = "observations", "actions", "values", "returns", "advantages"
        flat = {name: getattr(self, name).flatten(0, 1) for name in names}
        flat["old_actions_log_prob"] = self.actions_log_prob.flatten(0, 1)
        before = [values.flatten(0, 1) for values in self.distribution_params or ()]
        groups = self.rewards.new_empty(len(before[0]) // self.tradeoffs, self.tradeoffs)
        random = groups.uniform_().argsort(0)
        first = torch.arange(self.tradeoffs, device=self.device)
        batches = (random * self.tradeoffs + first).flatten().chunk(num_mini_batches)
        for _ in range(num_epochs):
            for rows in batches:
                yield RolloutStorage.Batch(
                    **{name: values[rows] for name, values in flat.items()},
                    old_distribution_params=tuple(values[rows] for values in before),
                )


class WorldFront(nn.Module):
    """The front of E worlds that act without noise under a fixed grid of trade-offs.

    Every trade-off's returns are means over the last episodes of EPISODES worlds, in which the
    networks went on learning.
    """

    def __init__(self, worlds: int, m: int, reference_point: Sequence[float] | None, device: Any):
        super().__init__()
        if worlds % EPISODES or worlds < EPISODES * m:
            raise MorlaxError(
                f"evaluation_worlds is {worlds}, but must be a multiple of {EPISODES}, and at "
                f"least {EPISODES} for each of the {m} objectives, or 0 for no front."
            )
        self.worlds, self.reference_point = worlds, reference_point
        self.number = worlds // EPISODES  # of trade-offs
        # (K', m); world e has trade-off e % K'
        self.tradeoffs = nn.Buffer(even_tradeoffs(self.number, m))
        # (E, m) of the episodes under way, and returns of the last ones
        self.sums = nn.Buffer(torch.zeros(worlds, m, dtype=torch.float32))
        self.last = nn.Buffer(torch.full_like(self.sums, math.nan))
        # (m,) returns of any trade-off so far
        self.worst = nn.Buffer(torch.full((m,), math.inf, dtype=torch.float32))
        # (E, 1) whether an episode began here; first ones may start at any step
        self.begun = nn.Buffer(torch.zeros(worlds, 1, dtype=torch.bool))
        self.to(device)

    def observe(self, rewards: Tensor, dones: Tensor) -> None:
        """Add rewards (E, m) of a step, after which the episodes of `dones` (E,) are over."""
        self.sums += rewards
        over = dones[:, None] > 0
        self.last.copy_(torch.where(over & self.begun, self.sums, self.last))
        self.sums.masked_fill_(over, 0.0)
        self.begun |= over

    def returns(self) -> Tensor | None:
        """Return the mean returns (K', m) by trade-off; None until each world has some."""
        if self.last.isnan().any():
            return None
        return self.last.unflatten(0, (-1, self.number)).mean(0)

    def indicators(self) -> dict[str, float]:
        """Return the hypervolume and the share of trade-offs whose returns are non-dominated."""
        if (returns := self.returns()) is None:
            return {}
        points = returns.cpu().numpy()
        self.worst.copy_(torch.minimum(self.worst, returns.amin(0)))
        worst = self.worst.tolist()
        return {
            "hypervolume": pareto.hypervolume(points, self.reference_point or worst),
            "non_dominated": pareto.cardinality(points) / len(points),
        }
