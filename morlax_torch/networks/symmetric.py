"""Networks of robots whose left and right are alike."""

from torch import Tensor, nn

from ..envs.worlds.mirror import Reflection


class Symmetric(nn.Module):
    """A network that answers a mirrored input by the mirrored output, or almost.

    f(x) = (1 + a) / 2 g(x) + (1 - a) / 2 M'g(Mx), where M and M' reflect inputs and outputs. With
    a = 0 that is exact (Ravindran and Barto, 2001, on symmetries of decisions; "NET" in
    Abdolhosseini et al., "On Learning Symmetric Locomotion", 2019). But then a robot that stands
    exactly symmetric moves both legs alike; with a > 0 it can take a first step.

    Args:
        network: g, from inputs (B, I) to outputs (B, O).
        inputs: M.
        outputs: M'.
        asymmetry: a, from 0 to 1, where f = g.
    """

    def __init__(
        self, network: nn.Module, inputs: Reflection, outputs: Reflection, asymmetry: float = 0.0
    ):
        super().__init__()
        self.network, self.shares = network, ((1 + asymmetry) / 2, (1 - asymmetry) / 2)
        for name, reflection in (("inputs", inputs), ("outputs", outputs)):
            self.register_buffer(f"{name}_order", reflection.order)
            self.register_buffer(f"{name}_sign", reflection.sign)

    inputs_order: Tensor
    inputs_sign: Tensor
    outputs_order: Tensor
    outputs_sign: Tensor

    def forward(self, x: Tensor) -> Tensor:
        inputs = Reflection(self.inputs_order, self.inputs_sign)
        outputs = Reflection(self.outputs_order, self.outputs_sign)
        return self.mixed(self.network(x), outputs(self.network(inputs(x))))

    def mixed(self, own: Tensor, mirrored: Tensor) -> Tensor:
        """Return f(x) from g(x) and M'g(Mx)."""
        mine, its = self.shares
        return mine * own + its * mirrored
