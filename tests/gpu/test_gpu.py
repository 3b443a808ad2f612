"""On CUDA, recorded graphs match eager execution, and robots learn."""

import gc
import warnings
from typing import Any

import gymnasium
import mujoco_warp
import numpy as np
import pytest
import torch
from tiny import Blind
from torch import nn

from morlax_torch import MORLAX, config_for, envs
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.tradeoffs import evaluation_tradeoffs
from morlax_torch.evaluation.evaluator import Evaluator
from morlax_torch.gpu import fused, mlp_kernels
from morlax_torch.gpu.graph import Branch, Graph
from morlax_torch.networks.hypernetwork import Hypernetwork
from morlax_torch.train import train

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(
        not hasattr(mujoco_warp.Option, "deterministic"),
        reason="MuJoCo Warp before 4.0 has no deterministic mode",
    ),
]
SMALL = {
    "worlds": 256,
    "horizon": 8,
    "sampling": {"cells": True},
    "ppo": {"minibatches": 4, "epochs": 2},
}


def trainer(
    task: str,
    recorded: bool,
    options: dict[str, Any] | None = None,
    device: str = "cuda",
    **networks: nn.Module,
) -> MORLAX:
    options = options or {}
    config = load_config({"env": task, **SMALL, "task": options})
    env = envs.make(task, config.worlds, device, deterministic=True, **options)
    morlax = MORLAX(env, config, **networks)
    # the simulator's atomics change the last bit, and TF32 would amplify that
    torch.set_float32_matmul_precision("highest")
    if recorded:
        morlax.compile()
    return morlax


def trained(task: str) -> MORLAX:
    morlax = trainer(task, recorded=True)
    for _ in range(4):
        morlax.iterate()
    return morlax


def assert_same_training(eager: MORLAX, recorded: MORLAX) -> None:
    """Compare single iterations from equal states.

    Contacts and Adam amplify rounding errors, so the states are synchronized before each iteration.
    """
    for _ in range(3):
        recorded.load_state_dict(eager.state_dict())
        before = learned(eager)
        eager.iterate()
        recorded.iterate()
        torch.testing.assert_close(recorded.tradeoffs, eager.tradeoffs)
        difference = (recorded.rollout.reward - eager.rollout.reward).abs()
        assert difference.median() < 1e-4  # a few worlds may diverge
        assert difference.mean() < 1e-2
        moved = learned(eager) - before
        assert moved.norm() > 0
        assert (learned(recorded) - before - moved).norm() < 0.1 * moved.norm()


def learned(morlax: MORLAX) -> torch.Tensor:
    return nn.utils.parameters_to_vector(morlax.agent.parameters()).detach().clone()


@pytest.mark.parametrize("task", [name for name in envs.names() if "/" not in name])
def test_recorded_graphs_match_eager_execution(task: str):
    assert_same_training(trainer(task, False), trainer(task, True))


def test_custom_networks_with_privileged_observations_are_recorded():
    envs.register("blind", Blind)
    actor = nn.Sequential(nn.Linear(6, 32), nn.LayerNorm(32), nn.ELU(), nn.Linear(32, 8))
    critic = nn.Sequential(nn.Linear(13, 32), nn.ELU(), nn.Linear(32, 2))
    assert_same_training(*(trainer("blind", r, actor=actor, critic=critic) for r in (False, True)))


RANDOM = {
    "hopper": {
        "randomization": {
            "friction": (0.5, 1.5),
            "mass": (0.8, 1.2),
            "strength": (0.8, 1.2),
            "fields": {"dof_damping": (0.5, 2.0)},
            "observation_noise": {"position": 0.01},
            "action_delay": (0, 2),
            "push": 0.5,
            "push_every": 5,
        }
    },
    "bruce": {"draw_commands": True, "noise": 1.0, "randomize": True},
}


@pytest.mark.parametrize("task", RANDOM)
def test_randomized_worlds_are_recorded(task: str):
    eager, recorded = (trainer(task, r, RANDOM[task]) for r in (False, True))
    assert_same_training(eager, recorded)
    name = "model.body_mass"
    assert torch.equal(recorded.env.state_dict()[name], eager.env.state_dict()[name])


def test_deterministic_worlds_are_reproducible():
    def last_state() -> torch.Tensor:
        env = envs.make("cheetah", 64, "cuda", deterministic=True)
        actions = torch.Generator("cuda").manual_seed(0)
        for _ in range(100):
            env.step(torch.rand(64, 6, generator=actions, device="cuda") * 2 - 1)
        return env.physics.qpos.clone()

    torch.testing.assert_close(last_state(), last_state(), rtol=0, atol=1e-3)


def test_a_recorded_evaluation_matches_an_eager_one():
    morlax = trained("cheetah")
    fronts = []
    for recorded in (False, True):
        env = envs.make("cheetah", 16, "cuda", deterministic=True, auto_reset=False)
        evaluator = Evaluator(morlax.agent, env, evaluation_tradeoffs(16, 2))
        if recorded:
            evaluator.compile()
        fronts.append(evaluator.evaluate())
    torch.testing.assert_close(
        torch.tensor(fronts[0].returns), torch.tensor(fronts[1].returns), rtol=1e-2, atol=1.0
    )


def test_training_resumes_from_a_restored_state():
    morlax = trained("walker")
    state = morlax.state_dict()
    morlax.iterate()
    first = morlax.rollout.reward.clone()
    morlax.load_state_dict(state)
    morlax.iterate()
    # the simulator's atomics cause tiny differences, and contacts amplify them
    torch.testing.assert_close(morlax.rollout.reward, first, rtol=0, atol=1e-3)


def test_gymnasium_worlds_on_cuda_match_the_cpu():
    options = {"num_envs": 3, "backend": "warp", "episode_length": 4}
    on_gpu, on_cpu = (
        gymnasium.make_vec("morlax_torch/Hopper-v0", device=device, **options)
        for device in ("cuda", "cpu")
    )
    for env in (on_gpu, on_cpu):
        env.reset(seed=0)
    generator = torch.Generator().manual_seed(0)
    for _ in range(10):
        action = torch.rand(3, 4, generator=generator) * 2 - 1
        found, expected = on_gpu.step(action.cuda())[:4], on_cpu.step(action)[:4]
        for values, right in zip(found, expected, strict=True):
            assert values.is_cuda
            torch.testing.assert_close(values.cpu(), right, rtol=1e-2, atol=1e-3)


def test_the_seed_determines_the_noise_of_recorded_gymnasium_steps():
    options = {"reset_noise": 0.1, "episode_length": 2}
    env = gymnasium.make_vec("morlax_torch/Hopper-v0", num_envs=64, device="cuda", **options)
    seen = []
    for seed in (1, 1, 2):
        env.reset(seed=seed)
        for _ in range(2):  # the second step ends every episode and draws new initial states
            observation = env.step(torch.zeros(64, 4, device="cuda"))[0]
        seen.append(observation)
    torch.testing.assert_close(seen[0], seen[1])
    assert not torch.allclose(seen[0], seen[2], atol=1e-3)


two_gpus = pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two GPUs")


@two_gpus
@pytest.mark.parametrize("recorded", [False, True])
def test_a_branch_uses_streams_of_its_own_device(recorded):
    device = torch.device("cuda:1")
    torch.cuda.set_device(0)
    heavy = torch.randn(4096, 4096, device=device) / 64
    source, copy, result = (torch.zeros(4096, 4096, device=device) for _ in range(3))
    count = torch.zeros((), device=device)
    branch = Branch(device)

    def run() -> None:
        for _ in range(4):  # keeps the main stream busy before it writes the branch's input
            source.copy_(heavy @ heavy)
        count.add_(1)
        source.fill_(1).mul_(count)
        with branch:
            for _ in range(4):
                copy.copy_(heavy @ heavy)
            copy.copy_(source)
        branch.join()
        result.copy_(copy)

    graph = Graph(run, device)
    if recorded:
        graph.record()
    stale = 0
    for _ in range(20):
        graph()
        torch.cuda.synchronize(device)
        stale += bool((result != count).any())
    assert stale == 0
    assert torch.cuda.current_device() == 0


@two_gpus
def test_a_learner_trains_on_the_second_gpu():
    torch.cuda.set_device(0)
    assert_same_training(*(trainer("cheetah", r, device="cuda:1") for r in (False, True)))


def tf32_learner(task: str, device: str = "cuda", draw: int = 0, **ppo: Any) -> MORLAX:
    """Build a learner whose policies and values depend on the trade-off, unlike at the start."""
    network = {"symmetric": True, "asymmetry": 0.3} if task == "walker" else {}
    config = load_config({"env": task, **SMALL, "network": network, "ppo": {**SMALL["ppo"], **ppo}})
    torch.set_float32_matmul_precision("highest")
    morlax = MORLAX(envs.make(task, config.worlds, device, deterministic=True), config)
    assert torch.get_float32_matmul_precision() == "high"  # building a learner enables TF32
    generator = torch.Generator(device).manual_seed(draw)
    for family in (morlax.agent.actor, morlax.agent.critic):
        nn.init.normal_(family.weight, std=0.01, generator=generator)
    return morlax


def explored(morlax: MORLAX) -> tuple[dict[str, Any], list[torch.Tensor]]:
    """Collect a rollout; return all that the update depends on."""
    morlax.explore()
    return morlax.state_dict(), [value.clone() for value in (morlax.tradeoffs, *morlax.rollout)]


def learn_from(
    morlax: MORLAX, state: dict[str, Any], seen: list[torch.Tensor]
) -> list[torch.Tensor]:
    """Update from what was `explored`; return the moments of Adam."""
    morlax.load_state_dict(state)
    for own, value in zip((morlax.tradeoffs, *morlax.rollout), seen, strict=True):
        own.copy_(value)
    morlax.learn()
    return [optimizer.mean.clone() for optimizer in morlax.ppo.optimizers]


@pytest.mark.parametrize("device", ["cuda", pytest.param("cuda:1", marks=two_gpus)])
@pytest.mark.parametrize("task", ["cheetah", "ant", "humanoid", "walker"])
def test_an_update_with_fused_kernels_is_that_of_torch(task: str, device: str, monkeypatch):
    """The error of the kernels is that of torch in TF32: in the median of five draws of networks.

    A policy's gradient divides by small spreads, so the errors of both, and which is larger, vary
    from draw to draw: on ant by factors from 0.4 to 4.5.
    """
    one_step = {"minibatches": 1, "epochs": 1}
    ratios = []
    for draw in range(5):
        morlax = tf32_learner(task, device, draw, **one_step)
        state, seen = explored(morlax)
        moments = [learn_from(morlax, state, seen)]  # of one step: a tenth of the clipped gradient
        with monkeypatch.context() as without:
            without.setattr(fused, "kernels", lambda device: None)
            for precision in ("high", "highest"):  # TF32, and exact
                learner = tf32_learner(task, device, draw, **one_step)
                torch.set_float32_matmul_precision(precision)
                moments.append(learn_from(learner, state, seen))
        ratios.append(
            [
                float((mine - exact).norm() / ((rounded - exact).norm() + 1e-4 * exact.norm()))
                for mine, rounded, exact in zip(*moments, strict=True)
            ]
        )
    assert np.median(ratios, 0).max() < 3


@pytest.mark.parametrize("task", ["cheetah", "ant"])
def test_a_recorded_update_with_fused_kernels_repeats_the_eager_one_bit_for_bit(task: str):
    morlax = tf32_learner(task)
    state, seen = explored(morlax)
    eager = learn_from(morlax, state, seen)
    morlax.compile()
    assert all(map(torch.equal, learn_from(morlax, state, seen), eager))


def test_recording_restores_the_garbage_collector_setting():
    total = torch.zeros((), device="cuda")
    gc.disable()
    try:
        Graph(lambda: total.add_(1), total.device).record()
        assert not gc.isenabled()
    finally:
        gc.enable()
    Graph(lambda: total.add_(1), total.device).record()
    assert gc.isenabled()


def test_recorded_steps_treat_a_huge_velocity_as_a_blow_up():
    morlax = trained("ant")
    morlax.env.physics.qvel[7] = 1e9
    for _ in range(2):
        morlax.iterate()
    metrics = morlax.metrics()
    assert metrics["blowups"] >= 1
    assert all(abs(value) < float("inf") for value in metrics.values())
    assert morlax.agent.value_normalizer.variance.max() < 1e6


def test_a_report_shows_a_robot_whose_policy_is_on_the_gpu(make_policy, rendered):
    from morlax_torch.viewers.filming.recording import portrait

    policy = make_policy("cheetah").to("cuda")
    picture = portrait(policy)
    assert picture is None or picture.startswith(b"\x89PNG")  # None: without OpenGL
    assert next(policy.parameters()).is_cuda


# what the paper's policies reach, or less where some seeds need longer
LEARNED = {"cheetah": 5.4e6, "walker": 5.28e6, "hopper": 5.5e6, "ant": 2.4e7, "humanoid": 0.74e6}


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(("task", "least"), LEARNED.items())
def test_robots_learn_in_ten_seconds(task: str, least: float, tmp_path, capsys):
    reached = []
    config = config_for(task, device="cuda", max_seconds=10.0, seed=0)
    train(config, output=tmp_path / "run", on_evaluation=lambda x: reached.append(x.hypervolume))
    with capsys.disabled():
        print(f"\n{task}: hypervolume {max(reached):.3g} after 10 s, needs {least:.3g}")
    assert max(reached) > least


def test_a_family_runs_where_a_host_has_set_the_precision():
    """mjlab sets it by torch's newer option, after which the older one cannot be read.

    rsl_rl then runs policies in inference mode, in which nothing can be differentiated.
    """
    matmul = torch.backends.cuda.matmul
    before, matmul.fp32_precision = matmul.fp32_precision, "tf32"
    try:
        family = Hypernetwork(nn.Linear(3, 2), num_objectives=2)
        tradeoffs, inputs = torch.rand(4, 2), torch.randn(4, 5, 3)
        expected = family.run(family(tradeoffs), inputs)
        family.cuda()
        fused.kernels.cache_clear()
        mlp_kernels.fits.cache_clear()
        with torch.inference_mode(), warnings.catch_warnings(action="error"):
            outputs = family.run(family(tradeoffs.cuda()), inputs.cuda())
    finally:
        matmul.fp32_precision = before
    torch.testing.assert_close(outputs.cpu(), expected, atol=1e-2, rtol=1e-2)
