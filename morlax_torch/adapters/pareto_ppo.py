"""rsl_rl's own PPO for a family of policies: one hypernetwork for every trade-off."""

import math
import os
from functools import cache
from inspect import signature
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.extensions import resolve_symmetry_config
from rsl_rl.models import MLPModel
from rsl_rl.utils import resolve_callable, resolve_obs_groups
from tensordict import TensorDict
from torch import Tensor, nn

from .. import envs
from ..configuration.config import Config, load_config
from ..configuration.tradeoffs import even_tradeoffs, one_tradeoff, parse_tradeoff, sample_cells
from ..envs.errors import LONGEST, MorlaxError, line, unknown
from ..envs.worlds.options import check_objectives
from ..networks.unbounded import GaussianMLP
from ..runs.checkpoint import RSL_RL
from .pareto_options import take_options
from .reward_terms import SIGNS, ObjectiveRewards, terms_of
from .rsl_rl_checkpoint import FAMILY, compact, contents, expanded
from .rsl_rl_family import EPISODES, FamilyModel, FamilyStorage, WorldFront

ACTION_SCALE = 10.0  # largest action of a policy in our own worlds, if the host does not clip
LEAST_RATE = 1e-5  # of rsl_rl's adaptive schedule
MADE_HERE = {"actor", "critic", "storage", "device", "multi_gpu_cfg"}  # arguments, not options
TRADEOFF = "MORLAX_TRADEOFF"  # environment variable: what an unmodified `play` shows


class ParetoPPO(PPO):
    """rsl_rl's PPO with one hypernetwork of policies for every trade-off between objectives.

        class_name: morlax_torch.rsl_rl:ParetoPPO

    in the section `algorithm` of an rsl_rl config, beside the options of PPO and of
    `ParetoOptions`; a YAML file that the environment variable MORLAX_PARETO names may hold the
    latter. Every rollout learns K trade-offs. The reward of a trade-off w is guide + sum_i w_i r_i,
    whose advantages are estimated per objective, weighted by w and normalized per trade-off. The
    update is rsl_rl's own. The first rollouts learn the focus alone, as PPO does.

    Every checkpoint also holds the plain actor of the focus, which an unmodified play script loads,
    and the family as a run of morlax, if `task` names it. The environment variable MORLAX_TRADEOFF
    changes what such a script shows: weights such as 0.2,0.8, or `all`, which spreads trade-offs
    over the worlds.

    Args:
        obs: the first observations, by group, (N, ...) each.
        env: the runner's worlds, whose rewards are first read when training starts.
        cfg: the runner's config; its section `algorithm` is emptied of our options.
        device: of networks and rollouts.

    Raises:
        MorlaxError: an option is wrong, or a model or an extension of rsl_rl is not supported.
    """

    actor: FamilyModel
    critic: FamilyModel
    storage: FamilyStorage

    @staticmethod
    def construct_algorithm(
        obs: TensorDict, env: Any, cfg: dict[str, Any], device: str
    ) -> "ParetoPPO":
        return resolve_callable(cfg["algorithm"]["class_name"])(obs, env, cfg, device)

    def __init__(self, obs: TensorDict, env: Any, cfg: dict[str, Any], device: str):
        algorithm = resolve_symmetry_config(cfg["algorithm"], env)
        algorithm.pop("class_name")
        options, theirs = take_options(algorithm), signature(PPO).parameters.keys() - MADE_HERE
        _check_supported(cfg)
        if other := next((name for name in algorithm if name not in theirs), None):
            raise unknown("option of ParetoPPO", other, [*type(options).model_fields, *theirs])
        cfg["obs_groups"] = groups = resolve_obs_groups(obs, cfg["obs_groups"], ["actor", "critic"])
        split = options.objectives, options.guide
        bind = cache(lambda: ObjectiveRewards(terms_of(env, options.terms), *split))
        # a script that plays may switch rewards off, such as Genesis' go2_eval.py
        names = options.objectives
        names = [*((bind().objectives if options.terms else SIGNS) if names is None else names)]
        try:
            check_objectives(names)
        except ValueError as error:
            raise MorlaxError(f"{error}.") from None
        worlds, m, K = env.num_envs, len(names), options.tradeoffs
        for name in ("focus", "reference_point"):
            if (point := getattr(options, name)) and len(point) != m:
                numbers = f"{m} numbers ({', '.join(names)})"
                raise MorlaxError(f"{name} needs {numbers}, not {len(point)}.")
        focus = one_tradeoff(options.focus or [1.0] * m, names, torch.device("cpu"))
        front = None
        if worlds < K + options.evaluation_worlds:  # to play
            K = 1
        elif options.evaluation_worlds:
            front = WorldFront(options.evaluation_worlds, m, options.reference_point, device)
        learning = worlds - (front.worlds if front else 0)

        def model(name: str, outputs: int) -> FamilyModel:
            network = {key: value for key, value in cfg[name].items() if key != "class_name"}
            focused = focus / focus.sum(), options.features
            return FamilyModel(obs[:1], groups, name, outputs, *focused, **network).to(device)

        actor, critic = model("actor", env.num_actions), model("critic", m)
        if shown := os.environ.get(TRADEOFF):
            if shown == "all":
                if worlds < m:
                    raise MorlaxError(
                        f"{TRADEOFF}=all shows one trade-off per world, and needs at least {m}: "
                        f"take more than {worlds}, such as mjlab's --num-envs 16."
                    )
                tradeoffs = even_tradeoffs(worlds, m)
            else:
                tradeoffs = torch.tensor([parse_tradeoff(shown, names)], dtype=torch.float32)
            actor.shown = critic.shown = tradeoffs.to(device)
        storage = FamilyStorage(
            *(m, K, "rl", learning, cfg["num_steps_per_env"], obs[:learning]),
            *([env.num_actions], device),
        )
        super().__init__(
            actor, critic, storage, device=device, multi_gpu_cfg=cfg["multi_gpu"], **algorithm
        )
        self.front, self.objectives = front, names
        self._env, self._options, self._cfg = env, options, cfg
        self._bind = bind  # when training starts
        self._rewards: ObjectiveRewards | None = None
        self._config: Config | None = None  # of the policies as a run of morlax, if they can be one
        self._rollouts = 0
        self._centers = even_tradeoffs(max(K, m), m).to(device)
        self._paid = torch.zeros_like(actor.tradeoffs[0])
        self._logged: dict[str, float] = {}

    def act(self, obs: TensorDict) -> Tensor:
        if self.storage.step == 0:
            self._begin_rollout()
        learning = self.storage.num_envs
        actions = super().act(obs[:learning])
        if self.front is None:
            return actions
        outputs = self.actor.run(obs[learning:], self.front.tradeoffs, self._graded)
        assert self.actor.distribution is not None
        return torch.cat([actions, self.actor.distribution.deterministic_output(outputs)])

    def _begin_rollout(self) -> None:
        K = self.storage.tradeoffs
        if self._rewards is None:
            self._check_sizes()
            self._rewards = self._bind()
            self._config = self._run_config(self._rewards)
        tradeoffs = torch.empty_like(self._centers)
        if warm := self._rollouts >= self._options.warmup:
            sample_cells(tradeoffs, self._centers)
            if len(tradeoffs) > K:  # fewer than objectives, which have their turns
                tradeoffs = tradeoffs[torch.randperm(len(tradeoffs))]
        else:
            tradeoffs, K = self.actor.focus[None], 1
        self._rollouts += 1
        for model in (self.actor, self.critic):
            model.family.features.requires_grad_(warm)
            model.family.weight.requires_grad_(warm)
            model.begin_rollout(tradeoffs[:K])
        self._paid.zero_()
        if self.front:
            self._graded = self.actor.family(self.front.tradeoffs)

    def _check_sizes(self) -> None:
        """Raise MorlaxError unless K divides worlds and minibatches; name the next K that does."""
        options, worlds = self._options, self.storage.num_envs
        if self._env.num_envs < options.tradeoffs + options.evaluation_worlds:
            raise MorlaxError(
                f"{self._env.num_envs} worlds are fewer than tradeoffs ({options.tradeoffs}) and "
                f"evaluation_worlds ({options.evaluation_worlds}) together: take more worlds, or "
                "less of both."
            )

        def fits(k: int) -> bool:
            rows = worlds // k * self.storage.num_transitions_per_env
            return worlds % k == 0 and rows % self.num_mini_batches == 0

        K = options.tradeoffs
        if not fits(K):
            lower = next((f"set tradeoffs to {k}, or " for k in range(K, 0, -1) if fits(k)), "")
            raise MorlaxError(
                f"tradeoffs ({K}) must divide the {worlds} worlds that learn, and each of the "
                f"{self.num_mini_batches} minibatches: {lower}change the number of worlds, "
                "evaluation_worlds or num_mini_batches."
            )

    def _run_config(self, rewards: ObjectiveRewards) -> Config | None:
        """Return the config of the policies as a run of morlax; None if it cannot have one."""
        options, K, worlds = self._options, self.storage.tradeoffs, self.storage.num_envs
        target, groups = self.actor.family.target, self.actor.obs_groups
        if options.task is None or not isinstance(target, GaussianMLP) or len(groups) > 1:
            return None
        fields = envs.get(options.task).Options.model_fields
        if "action_scale" not in fields:
            raise MorlaxError(
                f"morlax cannot open policies of rsl_rl in {options.task}, which has no "
                "action_scale: leave out the option task, or name mjlab:TASK or FILE.py:CLASS."
            )
        *layers, _ = target.mlp.children()
        hidden = [layer.out_features for layer in layers if isinstance(layer, nn.Linear)]
        task: dict[str, Any] = {
            "objectives": rewards.objectives,
            "guide": rewards.guide,
            "reference_point": options.reference_point,
            "action_scale": self._cfg.get("clip_actions") or ACTION_SCALE,
            "episode_length": int(self._env.max_episode_length),
        }
        manager = self._env.unwrapped.command_manager if "motion_file" in fields else None
        for term in map(manager.get_term, manager.active_terms) if manager else ():
            if file := getattr(term.cfg, "motion_file", ""):  # mjlab adds no stand at its end
                rate = 1 / self._env.unwrapped.step_dt
                fps = float(np.ravel(np.load(file).get("fps", rate))[0])
                if not math.isclose(fps, rate, rel_tol=1e-3):
                    raise MorlaxError(
                        f"{file} has {fps:g} frames per second, of which mjlab plays {rate:g}: "
                        f"write one with csv_to_npz --output-fps {rate:g} of mjlab, or train with "
                        "morlax, which interpolates."
                    )
                longest = min(task["episode_length"], term.motion.time_step_total - 1)
                task |= {"motion_file": file, "motion_stand": 0.0, "episode_length": longest}
        return load_config(
            {
                "env": options.task,
                "algorithm": "rsl-rl",
                "seed": max(self._cfg.get("seed") or 0, 0),  # -1: at random
                "worlds": worlds,
                "horizon": self.storage.num_transitions_per_env,
                "sampling": {"clusters": K if K > 1 else worlds, "corners": 0, "cells": True},
                "network": {"actor": hidden, "features": options.features},
                "ppo": {"minibatches": 1},
                "evaluation": {"tradeoffs": 64, "seeds": EPISODES},
                "method": {"activation": type(layers[1]).__name__},
                "task": task,
            }
        )

    def process_env_step(
        self, obs: TensorDict, rewards: Tensor, dones: Tensor, extras: dict[str, Any]
    ) -> None:
        learning = self.storage.num_envs
        assert self._rewards is not None
        parts, guide = self._rewards(rewards)
        learned = {name: extras[name][:learning] for name in extras if name == "time_outs"}
        total = (parts + guide)[:learning]
        super().process_env_step(obs[:learning], total, dones[:learning], learned)
        self._paid += parts.mean(0)
        if self.front:
            self.front.observe(parts[learning:], dones[learning:])
        if self.storage.step == self.storage.num_transitions_per_env:
            paid = (self._paid / self.storage.step).tolist()
            names = (f"mean_reward/{name}" for name in self.objectives)
            values = dict(zip(names, paid, strict=True))
            values |= self.front.indicators() if self.front else {}
            self._logged = {f"Pareto/{name}": value for name, value in values.items()}
            extras.setdefault("log", {})
        # rsl_rl 5.0 logs the names in the first log of a rollout alone, which should be the host's
        for name in extras.keys() & {"episode", "log"}:
            extras[name] |= self._logged

    def compute_returns(self, obs: TensorDict) -> None:
        storage, per_batch = self.storage, self.normalize_advantage_per_mini_batch
        self.normalize_advantage_per_mini_batch = True  # not across trade-offs, as it would here
        super().compute_returns(obs[: storage.num_envs])
        self.normalize_advantage_per_mini_batch = per_batch
        weights = self.actor.tradeoffs
        each = storage.advantages.unflatten(1, (-1, len(weights)))  # (T, N / K, K, m)
        weighted = (each * weights).sum(-1)
        std, mean = torch.std_mean(weighted, (0, 1))
        storage.advantages = ((weighted - mean) / (std + 1e-8)).flatten(1)[..., None]
        self.actor.end_rollout()
        self.critic.end_rollout()

    def _kind(self) -> dict[str, Any]:
        """Return what a checkpoint must have in common with this family."""
        shapes = {name: dict(getattr(self, name).family.shapes) for name in ("actor", "critic")}
        return {"objectives": self.objectives, "std_name": self.actor.std_name, "shapes": shapes}

    def save(self) -> dict[str, Any]:
        """Return the checkpoint: the family, its optimizer, and a plain actor."""
        saved = {
            "actor_state_dict": self.actor.plain(self.actor.shown[0]).state_dict(),
            FAMILY: {
                **self._kind(),
                "actor": self.actor.state_dict(),
                "critic": self.critic.state_dict(),
                "optimizer": compact(self.optimizer.state_dict()),
                "front": self.front.state_dict() if self.front else {},
                "rollouts": self._rollouts,
            },
        }
        if self._config is not None:
            saved[RSL_RL] = contents(self.actor, self._config, self.storage)
        return saved

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None, strict: bool) -> bool:
        """Load a family, or start every trade-off from the policy of a plain checkpoint.

        Raises:
            MorlaxError: the family has other objectives, features, layers, evaluation worlds or
                another optimizer, or the plain checkpoint other layers.
        """
        family = loaded_dict.get(FAMILY)
        if family is None:
            try:
                self.actor.start_from(loaded_dict["actor_state_dict"])
                if load_cfg is None or load_cfg.get("critic"):
                    self.critic.start_from(loaded_dict["critic_state_dict"])
            except (RuntimeError, KeyError) as error:
                raise MorlaxError(
                    "the plain checkpoint has other layers, normalizers or observations, or is of "
                    f"an rsl_rl before 5.0: train with the options that it has "
                    f"({line(error)[:LONGEST]})."
                ) from None
            self._rollouts = self._options.warmup
            if self.schedule == "adaptive":  # the first steps of a new optimizer are large
                self.learning_rate = LEAST_RATE
            return False
        states = {
            "actor_state_dict": family["actor"],
            "critic_state_dict": family["critic"],
            "optimizer_state_dict": expanded(family["optimizer"]),
        }
        try:
            for name, value in self._kind().items():
                if family[name] != value:
                    raise RuntimeError(f"its {name} are {family[name]}, not {value}")
            if load_cfg is None or load_cfg.get("optimizer"):
                groups = family["optimizer"]["param_groups"], self.optimizer.param_groups
                saved, own = ("adam" if "betas" in first else "sgd" for first, *_ in groups)
                if saved != own:
                    raise RuntimeError(f"its optimizer is {saved}, not {own}")
            self._rollouts = family["rollouts"]
            if load_cfg is None and self.front and family["front"]:
                self.front.load_state_dict(family["front"])
                self.front.begun.zero_()  # new worlds are in other episodes, at any step
            return super().load(states, load_cfg, strict)
        except RuntimeError as error:
            raise MorlaxError(
                "the checkpoint holds a family of other objectives, features, layers, evaluation "
                "worlds or another optimizer: train with the options that it has "
                f"({line(error)[:LONGEST]})."
            ) from None


def _check_supported(cfg: dict[str, Any]) -> None:
    algorithm = cfg["algorithm"]
    for name in ("actor", "critic"):
        kind = resolve_callable(cfg[name].get("class_name", "MLPModel"))
        if kind is not MLPModel:
            raise MorlaxError(
                f"the {name} is a {kind.__name__}, but ParetoPPO trains MLPModel: recurrent and "
                "convolutional models are not supported."
            )
    if algorithm.get("rnd_cfg"):
        raise MorlaxError("ParetoPPO has no curiosity rewards: remove rnd_cfg.")
    if algorithm.get("optimizer", "adam").lower() == "rmsprop":
        raise MorlaxError("ParetoPPO cannot save RMSprop's state: set optimizer to adam.")
    if cfg.get("torch_compile_mode"):
        raise MorlaxError("ParetoPPO does not compile its models: remove torch_compile_mode.")
    algorithm.pop("share_cnn_encoders", None)
    algorithm["rnd_cfg"] = None  # the runner reads it
