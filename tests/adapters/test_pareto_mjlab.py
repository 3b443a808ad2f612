"""mjlab's own train and play commands, with a front; its checkpoint as a run of morlax."""

import sys
from importlib import import_module, reload
from pathlib import Path
from typing import Any

import onnxruntime
import pytest
import torch
from motions import write_squat

from morlax_torch import MorlaxError, load
from morlax_torch.__main__ import command
from morlax_torch.exports.exporting import export
from morlax_torch.rsl_rl import specialize
from morlax_torch.viewers.explorer import library
from morlax_torch.viewers.explorer.session import Session, policies_of

pytest.importorskip("mjlab", reason="needs the extra mjlab")

TASK = "Velocity-Flat-Unitree-Go1"
OPTIONS = {
    "--env.scene.num-envs": 32,
    "--agent.max-iterations": 2,
    "--agent.num-steps-per-env": 8,
    "--agent.logger": "tensorboard",
    "--gpu-ids": None,
}
PARETO = {
    "--agent.algorithm.tradeoffs": 2,
    "--agent.algorithm.evaluation-worlds": 24,
    "--agent.algorithm.warmup": 1,
}


def run_train(monkeypatch: Any, task: str, folder: Path, **options: Any) -> Path:
    """Run mjlab's command `train`; returns the folder of its checkpoints."""
    from mjlab.scripts import train

    words = [str(word) for pair in {**OPTIONS, **options}.items() for word in pair]
    monkeypatch.setattr(sys, "argv", ["train", task, *words, "--log-root", str(folder)])
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    train.main()
    return next(folder.glob("*/*/model_1.pt")).parent


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        return run_train(patch, f"Pareto-{TASK}", tmp_path_factory.mktemp("logs"), **PARETO)


def policy_of_play(monkeypatch: Any, task: str, checkpoint: Path) -> Any:
    """Return the policy that mjlab's command `play` shows, after a few steps."""
    from mjlab.scripts import play

    class Viewer:
        def __init__(self, env: Any, policy: Any, **others: Any):
            self.env, self.policy = env, policy

        def run(self) -> None:
            with torch.inference_mode():
                for _ in range(3):
                    self.env.step(self.policy(self.env.get_observations()))
            shown.append(self.policy)

    shown: list[Any] = []
    monkeypatch.setattr(play, "NativeMujocoViewer", Viewer)
    settings = {"num_envs": 2, "device": "cpu", "viewer": "native"}
    play.run_play(task, play.PlayConfig(checkpoint_file=str(checkpoint), **settings))
    return shown[0]


def test_mjlab_s_play_shows_the_front_s_policies(run, monkeypatch, tmp_path):
    plain = policy_of_play(monkeypatch, f"Mjlab-{TASK}", run / "model_1.pt")
    family = policy_of_play(monkeypatch, f"Pareto-{TASK}", run / "model_1.pt")
    specialize(run / "model_1.pt", (1, 1, 0), tmp_path / "model_9.pt")
    special = policy_of_play(monkeypatch, f"Mjlab-{TASK}", tmp_path / "model_9.pt")
    observation = torch.randn(5, plain.obs_dim)
    with torch.no_grad():
        actions = [x({"actor": observation}) for x in (plain, family, special)]
    torch.testing.assert_close(actions[1], actions[0])
    torch.testing.assert_close(actions[2], actions[0])


def test_a_checkpoint_of_mjlab_is_a_run(run, tmp_path):
    policy = load(run)
    assert policy.objectives == ("tracking", "smoothness", "effort")
    assert policy.config.task.reference_point == (55.0, 0.0, 0.0)  # so that curves compare
    weights = policy.reward_weights((1.0, 0.0, 0.0))
    assert weights["track_linear_velocity"] == 1.6 and weights["action_rate_l2"] == 0.4
    own = policy.reward_weights((0.5, 0.5, 0.0))
    assert own.pop("is_alive") == pytest.approx(0.2)
    paid = {name: weight for name, weight in own.items() if weight}
    assert paid == pytest.approx(dict.fromkeys(paid, 1.0)) and len(paid) == 10  # mjlab's reward
    assert export(policy, tmp_path / "policy.onnx") < 1e-5
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    assert len(session.get_inputs()) == 2  # the trade-off stays an input


def test_a_checkpoint_of_mjlab_is_explored_exported_and_played(run, tmp_path, capsys):
    session = Session(*policies_of(library.choose(str(run))))
    session.tradeoff = (0.2, 0.3, 0.5)
    assert [session.advance(second / 10) for second in range(3)] == [0, 5, 5]  # of 20 ms
    command(["export", str(run), "--output", str(tmp_path / "family.onnx")])
    command(["play", str(tmp_path), "--episodes", "1", "--seconds", "1"])  # in C MuJoCo
    assert "cost of transport" in capsys.readouterr().out


def test_a_checkpoint_of_a_tracking_twin_follows_its_motion(monkeypatch, tmp_path):
    motion = {"--env.commands.motion.motion-file": write_squat(tmp_path / "squat.npz")}
    twin = "Pareto-Tracking-Flat-Unitree-G1"
    run = run_train(monkeypatch, twin, tmp_path / "logs", **PARETO, **motion)
    policy = load(run)
    assert policy.config.task.episode_length == 99  # the motion has 100 frames, as in mjlab
    robot = Session(policy, None)
    assert robot.ghost is not None and robot.env.episode_length == 99
    motion = {"--env.commands.motion.motion-file": write_squat(tmp_path / "fast.npz", fps=60)}
    with pytest.raises(MorlaxError, match="60 frames per second, of which mjlab plays 50"):
        run_train(monkeypatch, twin, tmp_path / "others", **PARETO, **motion)


def test_one_flag_and_a_file_train_a_front_in_a_task_of_mjlab(monkeypatch, tmp_path):
    file = tmp_path / "pareto.yaml"
    file.write_text("{tradeoffs: 2, evaluation_worlds: 16}")
    monkeypatch.setenv("MORLAX_PARETO", str(file))
    flag = {"--agent.algorithm.class-name": "morlax_torch.rsl_rl:ParetoPPO"}
    folder = run_train(monkeypatch, f"Mjlab-{TASK}", tmp_path / "logs", **flag)
    family = torch.load(folder / "model_1.pt", weights_only=True)["family"]
    assert family["objectives"] == ["rewards", "costs"]


@pytest.mark.parametrize("name", ["Cartpole", "Acme-Velocity-Flat-Unitree-Go1"])
def test_tasks_of_other_packages_may_have_any_name(name, monkeypatch):
    twins = import_module("morlax_torch.adapters.mjlab_tasks")
    monkeypatch.setattr(twins.registry, "list_tasks", lambda: [name])
    reload(twins)  # as mjlab imports it after such a package
