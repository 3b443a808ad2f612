"""Domain randomization: models, observation noise, action delay and pushes."""

import mujoco
import numpy as np
import torch
from mujoco import mjtBias, mjtGain
from torch import Tensor

from ..devices import Draws
from ..errors import MorlaxError, unknown
from ..physics.interface import Fields, Physics
from ..physics.mujoco import MODEL_FIELDS, cannot_vary
from .mujoco_robot import Part
from .options import Randomization
from .trees import horizontal

LINEAR = [int(kind) for kind in (mjtGain.mjGAIN_FIXED, mjtGain.mjGAIN_AFFINE)]
LINEAR_BIAS = [int(kind) for kind in (mjtBias.mjBIAS_NONE, mjtBias.mjBIAS_AFFINE)]


def draw(model: mujoco.MjModel, options: Randomization, num_worlds: int, seed: int) -> Fields:
    """Draw the model fields (N, ...) that differ between worlds, by name."""
    random, factors = np.random.default_rng(seed), {}

    def drawn(limits: tuple[float, float], *shape: int) -> np.ndarray:
        return random.uniform(*limits, (num_worlds, *shape))

    if options.friction:
        factor = drawn(options.friction, 1, 1)  # a contact takes the larger of two
        factors |= {"geom_friction": factor, "pair_friction": factor}
    if options.mass:
        factor = drawn(options.mass, model.nbody)
        factors |= {"body_mass": factor, "body_inertia": factor[..., None]}
    if options.strength:
        linear = np.isin(model.actuator_gaintype, LINEAR)
        linear &= np.isin(model.actuator_biastype, LINEAR_BIAS)
        if not linear.all():
            name = model.actuator(linear.argmin()).name
            raise MorlaxError(
                f"task.randomization.strength: the actuator {name!r} is not a plain motor, "
                "position servo or velocity servo: leave it out."
            )
        factor = drawn(options.strength, len(linear), 1)
        factors |= {"actuator_gainprm": factor, "actuator_biasprm": factor}
    for name, limits in options.fields.items():
        field = getattr(model, name, None) if name in MODEL_FIELDS else None
        if not isinstance(field, np.ndarray) or field.dtype.kind != "f" or not field.size:
            raise cannot_vary("MuJoCo", name)
        factors[name] = drawn(limits, *field.shape) * factors.get(name, 1.0)
    products = {name: getattr(model, name) * factor for name, factor in factors.items()}
    return {name: values for name, values in products.items() if values.size}


class Noise:
    """Gaussian observation noise, drawn once per control step.

    `deviations`: standard deviations in the units of the observation, by the name of a part
    ("position.knee") or a prefix of several ("position"). The longest match applies.
    """

    def __init__(
        self, deviations: dict[str, float], parts: list[Part], physics: Physics, draws: Draws
    ):
        words = [part.name.split(".") for part in parts]
        names = {".".join(some[: n + 1]) for some in words for n in range(len(some))}
        for name in deviations.keys() - names:
            raise unknown("part of the observation", name, names)
        values = []  # of each number
        for name, size, _ in parts:
            near = [key for key in deviations if f"{name}.".startswith(f"{key}.")]
            values += [deviations[max(near, key=len)] if near else 0.0] * size
        self._draws = draws
        self._deviations = torch.tensor(values, dtype=torch.float32, device=physics.device)
        self.now = self._deviations.new_zeros(physics.num_worlds, len(values))  # (N, O)
        self.state = {"noise": self.now}

    def draw(self) -> None:
        """Draw the noise of a new control step into `now` (N, O)."""
        self._draws.normal_(self.now).mul_(self._deviations)


class Delay:
    """Delays actions by some control steps; zero actions apply until the first one arrives.

    `steps` are the smallest and largest delay, drawn per world at the start of each episode.
    """

    def __init__(self, steps: tuple[int, int], action_size: int, physics: Physics, draws: Draws):
        self.steps, self._draws = steps, draws
        N, A, device = physics.num_worlds, action_size, physics.device
        # newest first
        self._past = torch.zeros(steps[1] + 1, N, A, dtype=torch.float32, device=device)
        self._late = torch.full((N,), steps[0], device=device)
        self._worlds = torch.arange(N, device=device)
        self.state = {"late": self._late, "past_actions": self._past}

    def __call__(self, action: Tensor) -> Tensor:
        """Store `action` (N, A) and return the delayed actions (N, A) to apply now."""
        self._past.copy_(self._past.roll(1, 0))
        self._past[0] = action
        return self._past[self._late, self._worlds]

    def begin(self, over: Tensor) -> None:
        """Start new episodes in the worlds `over` (N,) bool."""
        self._past.masked_fill_(over[:, None], 0.0)
        fewest, most = self.steps
        if most > fewest:
            drawn = self._draws.integers_(torch.empty_like(self._late), fewest, most + 1)
            self._late.copy_(torch.where(over, drawn, self._late))


class Pushes:
    """Sudden changes of the robot's horizontal velocity by `speed` m/s, in random directions.

    Every control step has the same probability, 1 / `every`.
    """

    def __init__(self, speed: float, every: int, base: int, physics: Physics, draws: Draws):
        self.speed, self.chance = speed, 1 / every
        self.physics, self._draws = physics, draws
        dofs = horizontal(physics.model, base)
        if not dofs:
            raise MorlaxError(
                "task.randomization.push: this robot cannot be pushed, because its base "
                f"{physics.model.body(base).name} has neither a free joint nor a slide joint along "
                "the floor: remove the option, or name another body, base_body of the task."
            )
        self._dofs = torch.tensor(dofs, device=physics.device)

    def __call__(self) -> None:
        """Push a random subset of the worlds."""
        shape = self.physics.num_worlds, len(self._dofs)
        direction = self._draws.normal_(self.physics.qvel.new_empty(shape))
        direction /= direction.norm(dim=-1, keepdim=True)
        chances = self._draws.uniform_(direction.new_empty(shape[0], 1))
        push = torch.where(chances < self.chance, self.speed * direction, 0.0)
        self.physics.qvel.index_add_(1, self._dofs, push)
