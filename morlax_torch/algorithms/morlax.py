"""MORLAX: one hypernetwork, which learns from the policies of K random trade-offs at a time."""

from .trainer import Trainer


class MORLAX(Trainer):
    """Trains an `Agent` in worlds, one `iterate` at a time.

    `state_dict` copies all state, and `load_state_dict` continues from a copy: bit for bit on the
    CPU, on CUDA up to the order of floating-point sums. `explore` and `learn` are the two halves
    of an iteration. On CUDA, call `compile` once, and they become recorded graphs.

    Building one on CUDA enables TF32 for matrix products in this process.

    Args:
        env: the worlds.
        config: every number of the run.
        actor: replaces the config's actor: a module from observations (B, O) to (B, 2A), means and
            spreads (see `TanhNormal`).
        critic: replaces the config's critic: a module from (B, O + P), with privileged features,
            to one value per objective (B, m), or to one value if `ppo.critic` is scalar.
        group: processes that train the same agent, each in its own worlds. It starts with the
            parameters and buffers of the first process.

    Raises:
        MorlaxError: config and worlds disagree, or a network does not fit the worlds.
    """
