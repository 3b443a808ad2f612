"""A front in rsl_rl's own training: class_name morlax_torch.rsl_rl:ParetoPPO (docs/rsl-rl.md)."""

from .envs.errors import require

require("ParetoPPO", "rsl-rl-lib", "5.0", "rsl-rl")

from .adapters.pareto_options import ParetoOptions
from .adapters.pareto_ppo import ParetoPPO
from .adapters.rsl_rl_checkpoint import specialize

__all__ = ["ParetoOptions", "ParetoPPO", "specialize"]
