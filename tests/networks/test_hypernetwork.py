"""Hypernetworks generate the parameters M f(w) + b of any module; conditioned networks take w."""

import pytest
import torch
from torch import Tensor, nn
from torch.nn.functional import silu
from torch.nn.utils.parametrizations import spectral_norm

from morlax_torch import Hypernetwork, MorlaxError
from morlax_torch.networks.family import Conditioned
from morlax_torch.networks.mlp import mlp

K, B, M = 5, 4, 3  # trade-offs, inputs of each, objectives
TRADEOFFS = torch.tensor(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.2, 0.3, 0.5], [0.6, 0.3, 0.1]]
)


class Scaled(nn.Module):
    """A target with a buffer; buffers are not generated."""

    def __init__(self):
        super().__init__()
        self.linear = nn.Linear(3, 2)
        self.register_buffer("scale", torch.tensor([2.0, -3.0]))

    def forward(self, x: Tensor) -> Tensor:
        return self.scale * self.linear(x)


class Wave(nn.Module):
    """A target with buffers of other types than its parameters'."""

    def __init__(self):
        super().__init__()
        self.linear = nn.Linear(3, 2)
        self.register_buffer("phase", torch.randn(2, dtype=torch.complex64))
        self.register_buffer("shift", torch.randn(2, dtype=torch.float64))

    def forward(self, x: Tensor) -> Tensor:
        return (self.phase * self.linear(x)).imag + self.shift


TARGETS = {
    "linear": (lambda: nn.Linear(3, 2), [(3,)]),
    "mlp": (lambda: nn.Sequential(nn.Linear(3, 6), nn.SiLU(), nn.Linear(6, 2)), [(3,)]),
    "convolutional": (
        lambda: nn.Sequential(nn.Conv2d(2, 3, 3), nn.SiLU(), nn.Flatten(), nn.Linear(12, 2)),
        [(2, 4, 4)],
    ),
    "recurrent": (lambda: nn.GRUCell(3, 5), [(3,), (5,)]),
    "buffer": (Scaled, [(3,)]),
    "types": (Wave, [(3,)]),
}

NO_BATCHING_RULE = pytest.mark.filterwarnings("ignore:There is a performance drop:UserWarning")


@pytest.fixture(
    params=[
        pytest.param(name, marks=NO_BATCHING_RULE if name == "recurrent" else ())
        for name in TARGETS
    ]
)
def target(request: pytest.FixtureRequest) -> nn.Module:
    torch.manual_seed(1)
    return TARGETS[request.param][0]()


@pytest.fixture
def inputs(request: pytest.FixtureRequest, generator: torch.Generator) -> list[Tensor]:
    name = request.node.callspec.params["target"]
    return [torch.randn(K, B, *shape, generator=generator) for shape in TARGETS[name][1]]


def family_of(target: nn.Module, scale: float = 0.5) -> Hypernetwork:
    generator = torch.Generator().manual_seed(2)
    return Hypernetwork(target, M, (8, 7), 4, scale=scale, generator=generator)


def test_generated_parameters_are_affine_in_the_trade_off_s_features(target):
    family = family_of(target)
    generated = family.split(family.flat(TRADEOFFS))
    first, second, last = (family.features[index] for index in (0, 2, 4))
    for k, w in enumerate(TRADEOFFS):
        f = silu(second.weight @ silu(first.weight @ w + first.bias) + second.bias)
        flat = family.weight @ (last.weight @ f + last.bias) + family.bias
        start = 0
        for name, parameter in target.named_parameters():
            own = flat[start : start + parameter.numel()].view(parameter.shape)
            torch.testing.assert_close(generated[name][k], own)
            start += parameter.numel()
        assert start == len(flat)
    assert list(generated) == [name for name, _ in target.named_parameters()]


def test_with_scale_zero_every_tradeoff_starts_as_the_target(target, inputs):
    family = family_of(target, scale=0.0)
    parameters = family(TRADEOFFS)
    for name, parameter in target.named_parameters():
        assert torch.equal(parameters[name], parameter.expand(K, *parameter.shape))
    outputs = family.run(parameters, *inputs)
    for k in range(K):
        torch.testing.assert_close(outputs[k], target(*(x[k] for x in inputs)))


def test_tradeoffs_are_normalized_to_sum_to_one():
    family = family_of(nn.Linear(3, 2))
    factors = torch.tensor([0.01, 1.0, 2.0, 30.0, 512.0])[:, None]
    for name, value in family(factors * TRADEOFFS).items():
        torch.testing.assert_close(value, family(TRADEOFFS)[name])
        torch.testing.assert_close(value, family(factors * TRADEOFFS.double())[name])  # of numpy


def test_torch_func_maps_over_tradeoffs():
    family, x = family_of(TARGETS["mlp"][0]()), torch.ones(B, 3)

    def run(tradeoff: Tensor) -> Tensor:
        return family.run_one({n: rows[0] for n, rows in family(tradeoff[None]).items()}, x)

    outputs = family.run(family(TRADEOFFS), x.expand(K, B, 3))
    torch.testing.assert_close(torch.vmap(run)(TRADEOFFS), outputs)


def test_specialize_returns_a_plain_module_for_one_tradeoff(target, inputs):
    family = family_of(target)
    outputs = family.run(family(TRADEOFFS), *inputs)
    for k, tradeoff in enumerate(TRADEOFFS):
        member = family.specialize(tradeoff)
        assert type(member) is type(target)
        assert member.state_dict().keys() == target.state_dict().keys()
        torch.testing.assert_close(member(*(x[k] for x in inputs)), outputs[k])
        assert all(value.requires_grad for value in member.parameters())  # to be trained on
        for name, buffer in target.named_buffers():
            torch.testing.assert_close(member.get_buffer(name), buffer, rtol=0, atol=0)
    types = {value.dtype for value in family.double().specialize(TRADEOFFS[0]).parameters()}
    assert types == {torch.float64}


def test_dropout_is_active_in_training_alone():
    family = Hypernetwork(nn.Sequential(nn.Linear(3, 20), nn.Dropout()), num_objectives=M)
    for training in (True, False):
        outputs = family.train(training).run(family(TRADEOFFS), torch.ones(K, B, 3))
        for output in (outputs, family.specialize(TRADEOFFS[0])(torch.ones(B, 3))):
            assert (output == 0).any() == training


def test_all_parameters_get_a_gradient_but_the_features_of_a_zero_affine_map(target, inputs):
    for scale in (0.5, 0.0):
        family = family_of(target, scale)
        features = {f"features.{name}" for name, _ in family.features.named_parameters()}
        family.run(family(TRADEOFFS), *inputs).square().sum().backward()
        found = {name: parameter.grad.any().item() for name, parameter in family.named_parameters()}
        expected = {"weight": True, "bias": True, **dict.fromkeys(features, scale > 0)}
        assert found == expected


def test_parameters_of_another_family_are_refused():
    family = family_of(nn.Sequential(nn.Linear(3, 2), nn.ReLU()))
    with pytest.raises(RuntimeError, match=r"Missing key.*0\.bias"):  # not the target's own
        family.run(family_of(nn.Linear(3, 2))(TRADEOFFS), torch.ones(K, B, 3))


@pytest.mark.parametrize("dtype", [torch.float64, torch.complex64, torch.int64])
def test_targets_of_several_types_are_refused(dtype):
    target = Scaled()
    target.factor = nn.Parameter(torch.ones(2, dtype=dtype), requires_grad=False)
    with pytest.raises(MorlaxError, match="must be of one floating type, not torch"):
        Hypernetwork(target, M)


def test_targets_that_cannot_be_copied_are_refused_in_one_sentence():
    target = nn.Linear(3, 2)
    target.half = target.weight / 2
    with pytest.raises(MorlaxError, match="the target cannot be copied: RuntimeError: Only Tens"):
        Hypernetwork(target, M)


@pytest.mark.parametrize(
    ("layer", "kind"),
    [
        (nn.BatchNorm1d(4), "BatchNorm1d"),
        (nn.InstanceNorm1d(4, track_running_stats=True), "InstanceNorm1d"),
        (spectral_norm(nn.Linear(4, 4)), "SpectralNorm"),
    ],
)
def test_targets_that_update_buffers_are_refused_in_training(layer, kind):
    target = nn.Sequential(nn.Linear(3, 4), layer)
    with pytest.raises(MorlaxError, match=rf"the target's {kind} .* use nn\.LayerNorm, or pass"):
        Hypernetwork(target, M)
    Hypernetwork(target.eval(), M)
    Hypernetwork(nn.BatchNorm1d(3, track_running_stats=False), M)  # of rows alone


@pytest.mark.parametrize(
    "row", [[0.0, 0.0, 0.0], [-1.0, -2.0, 0.0], [float("nan"), 1.0, 0.0], [float("inf"), 1, 1]]
)
def test_trade_offs_without_a_direction_are_refused(row):
    for family in (Hypernetwork(nn.Linear(3, 2), M), Conditioned(nn.Linear(6, 2))):
        with pytest.raises(MorlaxError, match="must be finite, and the sum of its weights above 0"):
            family(torch.tensor([[0.2, 0.3, 0.5], row]))


@pytest.mark.parametrize("shape", [(1, 2), (3,)])
def test_trade_offs_of_the_wrong_shape_are_refused(shape):
    family = Hypernetwork(nn.Linear(3, 2), M)
    with pytest.raises(MorlaxError, match=r"are \(K, 3\) for this network, not \(") as error:
        family(torch.ones(shape))
    assert str(shape) in str(error.value)


@pytest.mark.parametrize("kind", ["mlp", "own"])
def test_a_conditioned_network_is_a_plain_one_with_the_trade_off_as_an_input(kind, generator):
    network = mlp(4 + M, (8,), 3, generator)
    if kind == "own":
        network = nn.Sequential(nn.Linear(4 + M, 8), nn.LayerNorm(8), nn.Tanh(), nn.Linear(8, 3))
    family, inputs = Conditioned(network), torch.randn(K, B, 4, generator=generator)
    found = family.run(family(2 * TRADEOFFS), inputs)
    rows = [torch.cat([x, w.expand(B, M)], 1) for x, w in zip(inputs, TRADEOFFS, strict=True)]
    wanted = torch.stack([network(x) for x in rows])
    torch.testing.assert_close(found, wanted)
    found.square().sum().backward()
    wanted.square().sum().backward()
    for mine, plain in zip(family.parameters(), network.parameters(), strict=True):
        torch.testing.assert_close(mine.grad, plain.grad)
    alone = family.specialize(2 * TRADEOFFS[0])
    with torch.no_grad():
        next(family.parameters()).zero_()
    torch.testing.assert_close(alone(inputs[0]), wanted[0])
