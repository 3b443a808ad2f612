"""Networks of robots whose left and right are alike."""

from torch import Tensor, nn

from ..envs.worlds.mirror import Reflection


class Symmetric(nn.Module):
    """A network that answers a mirrored input by the mirrored output: f(x) = (g(x) + M'g(Mx)) / 2.

    M and M' reflect inputs and outputs. (Ravindran and Barto, 2001, on symmetries of decisions;
    "NET" in Abdolhosseini et al., "On Learning Symmetric Locomotion", 2019.)

    Args:
        network: g, from inputs (B, I) to outputs (B, O).
        inputs: M.
        outputs: M'.
    """

    def __init__(self, network: nn.Module, inputs: Reflection, outputs: Reflection):
        super().__init__()
        self.network = network
        for name, reflection in (("inputs", inputs), ("outputs", outputs)):
            self.register_buffer(f"{name}_order", reflection.order)
            self.register_buffer(f"{name}_sign", reflection.sign)

    inputs_order: Tensor
    inputs_sign: Tensor
    outputs_order: Tensor
    outputs_sign: Tensor

    def forward(self, x: Tensor) -> Tensor:
        mirrored = x.index_select(-1, self.inputs_order) * self.inputs_sign
        other = self.network(mirrored).index_select(-1, self.outputs_order) * self.outputs_sign
        return (self.network(x) + other) / 2
