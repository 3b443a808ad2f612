"""Tasks of mjlab: their rewards, their last observations, and runs in them."""

import io
import json
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import mjlab_front
import mjlab_peer
import mujoco
import numpy as np
import pytest
import torch
from calm import calm
from peers import check_run
from recordable import NoCopies, NoSync, check_recordable, check_recorded_step
from same import csv_rows
from tiny import FEW, learner, tiny

from morlax_torch import MorlaxError, Policy, envs, evaluate, load
from morlax_torch.commands.terminal.arguments import read
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import task_values
from morlax_torch.envs.bridges.mjlab import worlds
from morlax_torch.envs.bridges.mjlab.mirror import mirror_of
from morlax_torch.envs.bridges.mjlab.step import MaskedStep
from morlax_torch.envs.bridges.mjlab.walking import torque_limits
from morlax_torch.envs.physics import compiling
from morlax_torch.exports.exporting import export
from morlax_torch.runs.choosing import choose
from morlax_torch.runs.loading import load_front
from morlax_torch.train import train
from morlax_torch.viewers.player import Player
from morlax_torch.viewers.playing.tour import costs

pytest.importorskip("mjlab", reason="needs the extra mjlab")

GO1 = "mjlab:Mjlab-Velocity-Flat-Unitree-Go1"
TOUR = "mjlab:Mjlab-Tour-Flat-Unitree-G1"
G1 = "mjlab:Mjlab-Velocity-Flat-Unitree-G1"
ROUGH = "mjlab:Mjlab-Velocity-Rough-Unitree-Go1"
CARTPOLE = "mjlab:Mjlab-Cartpole-Balance"


def noise(env: envs.Worlds) -> torch.Tensor:
    return 2 * torch.rand(env.num_worlds, env.action_size) - 1


@pytest.fixture(autouse=True)
def narrow_ground(monkeypatch) -> None:
    """Five columns of uneven ground instead of twenty, which take many seconds to build."""
    registry = import_module("mjlab.tasks.registry")
    usual = registry.load_env_cfg

    def narrow(task: str, play: bool = False) -> Any:
        cfg = usual(task, play)
        if ground := cfg.scene.terrain and cfg.scene.terrain.terrain_generator:
            ground.num_cols = 5
        return cfg

    monkeypatch.setattr(registry, "load_env_cfg", narrow)


@pytest.fixture(scope="module", autouse=True)
def same_meshes() -> Iterator[None]:
    """Make the mesh of each height field once, instead of twice for each environment."""
    bvh, meshes = import_module("mujoco_warp._src.bvh"), {}
    usual = bvh._optimize_hfield_mesh

    def mesh(heights: np.ndarray, *sizes: float) -> tuple[np.ndarray, np.ndarray]:
        key = heights.tobytes(), *sizes
        if key not in meshes:
            meshes[key] = usual(heights, *sizes)
        return meshes[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bvh, "_optimize_hfield_mesh", mesh)
        yield


@pytest.fixture(scope="module")
def go1() -> envs.Worlds:
    """Go1s with mjlab's own rewards, and episodes so short that they end at different times."""
    return envs.make(GO1, 4, "cpu", episode_length=7)


def test_the_sum_of_all_objectives_is_the_reward_of_mjlab(go1):
    for _ in range(20):
        step = go1.step(noise(go1))
        torch.testing.assert_close(step.reward.sum(1), go1.env.reward_buf, rtol=0, atol=1e-6)
        torch.testing.assert_close(sum(step.terms.values()), step.reward.sum(1))
    assert go1.objectives == ("rewards", "costs")
    assert (step.reward[:, 0] > 0).all() and (step.reward[:, 1] < 0).all()


def test_worlds_restart_once_and_their_last_observation_is_kept(monkeypatch):
    monkeypatch.setattr(worlds, "supported", lambda *_: False)
    go1 = envs.make(GO1, 4, "cpu", episode_length=7)
    restarted, usual = [], go1.env._reset_idx
    monkeypatch.setattr(
        go1.env, "_reset_idx", lambda ids: (restarted.extend(ids.tolist()), usual(ids))[1]
    )
    episodes = 0
    for _ in range(20):
        restarted.clear()
        step = go1.step(noise(go1))
        over = step.terminated | step.truncated
        assert restarted == over.nonzero().squeeze(1).tolist()
        assert torch.equal((step.critic_observation != step.final_critic_observation).any(1), over)
        assert torch.equal(step.observation, step.critic_observation[:, : go1.observation_size])
        assert (go1.env.episode_length_buf[over] == 0).all()
        assert (go1.env.episode_length_buf < 7).all()
        episodes += int(over.sum())
    assert episodes >= 8  # 20 steps of 4 worlds, of 7 steps each at most


def test_joints_actions_and_contacts_of_a_last_observation_are_exact(monkeypatch):
    found = []
    for recordable in (True, False):
        monkeypatch.setattr(worlds, "supported", lambda *_, answer=recordable: answer)
        env = envs.make(GO1, 4, "cpu", episode_length=3, stagger=False)
        torch.manual_seed(0)
        step = [env.step(noise(env)) for _ in range(3)][-1]
        assert step.truncated.all()
        found.append(step.final_critic_observation[:, env.observation_size :])
    manager = env.env.observation_manager
    sizes = [torch.Size(dims).numel() for dims in manager.group_obs_term_dim["critic"]]
    quick, exact = (
        dict(zip(manager.active_terms["critic"], seen.split(sizes, 1), strict=True))
        for seen in found
    )
    late = {"base_lin_vel", "base_ang_vel", "projected_gravity", "command", "foot_height"}
    for name in quick:  # a physics step is 5 ms
        tolerance = 0.5 if name in late else 1e-6
        torch.testing.assert_close(quick[name], exact[name], rtol=0, atol=tolerance)


def test_worlds_that_are_not_finite_terminate_and_earn_nothing():
    env = envs.make(GO1, 3, "cpu")
    for _ in range(2):
        action = noise(env)
        action[1] = torch.nan
        step = env.step(action)
        assert step.blown_up.tolist() == step.terminated.tolist() == [False, True, False]
        assert not step.reward[1].any() and step.reward[0].any()
        assert step.observation.isfinite().all() and step.final_observation.isfinite().all()
    assert env.blowups == 2


@pytest.mark.filterwarnings("ignore:MULTICCD")
@pytest.mark.parametrize("name", [GO1, ROUGH, CARTPOLE])
def test_the_physics_of_a_step_is_compiled_ahead(name):
    ahead: dict = {}
    with compiling._no_launches(ahead):
        worlds.step_physics(worlds.load(name), "cpu")
    env = envs.make(name, 4, "cpu")
    step: dict = {}
    with compiling._no_launches(step):
        env.env.sim.step()
        env.env.sim.reset(torch.tensor([0, 2]))
    compiled, needed = (
        {module.get_module_identifier(size) for module, _, size in variants}
        for variants in (ahead, step)
    )
    assert len(needed) > 20 and needed <= compiled


def test_worlds_draw_from_a_generator_of_their_own():
    found = []
    for seed in (1, 2):
        env = envs.make(CARTPOLE, 3, "cpu", seed=5, stagger=False)
        torch.manual_seed(seed)
        before = torch.get_rng_state()
        found.append(env.reset())
        assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(*found)
    env.reseed(6)
    assert not torch.equal(env.reset(), found[0])


def test_evaluated_worlds_earn_nothing_once_they_are_over():
    env = envs.make(CARTPOLE, 3, "cpu", auto_reset=False, episode_length=5)
    env.reset()
    steps = [env.step(noise(env)) for _ in range(8)]
    assert steps[4].truncated.all() and steps[4].reward.any() and not steps[5].reward.any()
    env.restart(torch.tensor([True, False, False]))
    assert env.step(noise(env)).truncated.tolist() == [False, True, True]


def test_terms_of_weight_zero_and_terms_of_effort_can_be_used():
    objectives = {"track": {"smooth_reward": 1.0}, "save": {"electrical_power_cost": -0.5}}
    env = envs.make(CARTPOLE, 2, "cpu", objectives=objectives)
    for _ in range(5):
        step = env.step(torch.ones(2, env.action_size))
    assert env.reward_terms == ("smooth_reward", "electrical_power_cost")
    assert (step.terms["electrical_power_cost"] > 0).all()
    torch.testing.assert_close(step.reward[:, 1], -0.5 * step.terms["electrical_power_cost"])


def test_a_run_is_trained_evaluated_loaded_and_resumed(tmp_path, capsys):
    check_run(tiny(CARTPOLE, backend=None), tmp_path / "run", capsys)


@pytest.mark.parametrize("env", [GO1, G1])
def test_tuned_values_fit_the_task_and_the_device(env):
    config, _, _ = read(["--env", env, "--device", "cpu"])
    assert len(config.task.objectives) >= 3
    assert config.task.guide and "tracking" in config.task.objectives
    gpu, cpu = (load_config(task_values(env, where, "hyper-sac")) for where in ("cuda", "cpu"))
    assert gpu.worlds >= 1024 and cpu.worlds == 128
    for algorithm, ignored in (("hyper-sac", False), ("independent", True), ("hyper-morl", True)):
        focus = load_config(task_values(env, "cuda", algorithm)).sampling.focus
        assert (focus is None) == ignored


def test_a_task_by_another_name_has_its_robot_and_values():
    class Brief(envs.get(CARTPOLE)):
        class Options(envs.get(CARTPOLE).Options):
            episode_length: int = 20

    envs.register("brief-cartpole", Brief)
    robot = envs.make_robot("brief-cartpole")
    assert isinstance(robot, Brief) and robot.episode_length == 20
    values, expected = (task_values(name, "cpu") for name in ("brief-cartpole", CARTPOLE))
    assert values == {**expected, "env": "brief-cartpole"}


MISTAKES = [
    ("mjlab:Mjlab-Velocity-Flat-Unitree-Go2", {}, "did you mean 'Mjlab-Velocity-Flat-Unitree-Go1'"),
    ("mjlab:Mjlab-Tracking-Flat-Unitree-G1", {}, "--task.motion-file FILE.npz"),
    (GO1, {"commands": {"twist.speed": (0.0, 1.0)}}, "range of the command twist 'speed'"),
    (GO1, {"commands": {"twist.lin_vel_x": (1.0, 0.0)}}, "from the smaller to the larger"),
    (GO1, {"history": {"joint_pso": 2}}, "did you mean 'joint_pos'"),
    (GO1, {"history": {"*": 0}}, "observe nothing"),
]


@pytest.mark.parametrize(("name", "options", "message"), MISTAKES)
def test_mistakes_are_one_sentence(name, options, message):
    with pytest.raises(MorlaxError, match=message):
        envs.make(name, 2, "cpu", **options)


@pytest.fixture(scope="module")
def go1_run(tmp_path_factory) -> Path:
    config = tiny(GO1, backend=None, **FEW, **{"network.symmetric": True})
    return train(config, output=tmp_path_factory.mktemp("go1") / "run").folder


def test_a_robot_follows_the_command_that_a_viewer_sets(go1_run):
    front = load_front(go1_run)
    assert (front.lengths == 5).all() and (front.falls == 0).all()
    player = Player(load(go1_run, device="cpu"), (1, 0, 0))
    assert list(player.env.command_limits) == ["lin_vel_x", "lin_vel_y", "ang_vel_z"]
    player.command = [0.7, 0.0, -0.1]
    before = player.data.qpos.copy()
    for _ in range(3):
        player.step()
    seen = player.observation[0, -3:]  # mjlab's last part: the command
    torch.testing.assert_close(seen, torch.tensor(player.command))
    assert player.data.qpos[2] > 0.1 and (player.data.qpos != before).any()
    assert [part.size for part in player.env.layout()] == [3, 3, 12, 12, 12, 3]
    without_ranges = envs.make_robot("mjlab:Mjlab-Lift-Cube-Yam")
    assert without_ranges.command_limits == {}
    assert without_ranges.reset().isfinite().all()
    narrow = envs.make(GO1, 2, "cpu", commands={"twist.lin_vel_x": (0.5, 0.5)})
    assert narrow.env.cfg.commands["twist"].ranges.lin_vel_x == (0.5, 0.5)


def test_an_exported_policy_moves_the_joints_as_mjlab_does(go1_run, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime")
    policy = load(go1_run, device="cpu")
    weights = [0.5, 0.3, 0.2]
    export(policy, tmp_path / "go1.onnx", "onnx", weights)
    session = onnxruntime.InferenceSession(tmp_path / "go1.onnx")
    facts = {k: json.loads(v) for k, v in session.get_modelmeta().custom_metadata_map.items()}
    player = Player(policy, weights)
    seen = player.observation.clone()
    (action,) = session.run(None, {session.get_inputs()[0].name: seen.numpy()})
    player.step()
    term = player.env.env.action_manager.get_term("joint_pos")
    control = facts["control"]
    target = np.add(control["offset"], control["scale"] * action[0])
    np.testing.assert_allclose(target, term._processed_actions[0], rtol=0, atol=1e-5)
    assert [row["joint"] for row in facts["actuators"]] == term.target_names
    assert facts["control_rate_hz"] == 50


def test_a_front_is_compared_with_mjlab_s_own_training(go1_run, tmp_path, capsys):
    rows, peer, weightings = (tmp_path / name for name in ("rows.csv", "lazy.pt", "given.yaml"))
    weightings.write_text(f"{GO1.partition(':')[2]}: {{lazy: {{electrical_power_cost: -0.1}}}}")
    given = {"weighting": "lazy", "weightings": weightings, "worlds": 4, "device": "cpu"}
    for steps in (90, 150):
        mjlab_peer.main(peer, **given, steps=steps)
    # the second call goes on after the first: an iteration is 96 steps
    assert torch.load(peer, weights_only=False)["infos"]["env_steps"] == 192
    few = {"tradeoffs": 4, "episodes": 2, "device": "cpu", "figure": tmp_path / "front.png"}
    mjlab_front.main((go1_run,), (peer,), **few, output=rows)
    assert "mjlab: lazy: dominated by" in capsys.readouterr().out
    best, cheapest, lazy = csv_rows(rows)
    assert (best["policy"], cheapest["policy"]) == ("best tracking", "least power")
    assert best["non-dominated"] == cheapest["non-dominated"] in ("1", "2", "3", "4")
    assert lazy["policy"] == lazy["non-dominated"] == ""


@pytest.mark.parametrize(("name", "history"), [(GO1, 0), (G1, 0), (GO1, 5), (ROUGH, 0)])
def test_a_robot_moves_like_its_mirror_image(name, history, generator):
    def remember(cfg: Any) -> None:
        if history:
            cfg.observations["actor"].history_length = history
            cfg.observations["critic"].terms["joint_pos"].history_length = history - 2
        if name == ROUGH:  # the ground has a mirror image, too: a pyramid
            ground = cfg.scene.terrain.terrain_generator
            ground.num_rows, ground.difficulty_range = 2, (0.4, 0.4)
            stairs = replace(ground.sub_terrains["pyramid_stairs"], platform_width=0.7)
            ground.sub_terrains = {"stairs": stairs}

    env = calm(name, 2, edit=remember)
    if name == ROUGH:
        env.sim.data.qpos[:, 1] += torch.tensor([0.7, -0.7])  # to the left and the right of its top
    mirror = mirror_of(env, ["actor", "critic"], tolerance=0.01)
    env.command_manager.get_command("twist")[1, 1:] *= -1
    action = torch.zeros(env.action_manager.total_action_dim)
    apart, moved = [], []
    for _ in range(15):
        action = 0.8 * action + 0.4 * torch.randn(action.shape, generator=generator)
        groups, *_ = env.step(torch.stack([action, mirror.action(action)]))
        one, other = torch.cat([groups["actor"], groups["critic"]], 1)
        seen = slice(48, 235) if name == ROUGH else slice(None)  # the actor's scan of the ground
        apart.append((mirror.observation(one) - other)[seen].abs())
        moved.append((one - other)[seen].abs())
    # models are made of measured parts, whose left and right differ by millimeters
    assert torch.stack(apart).mean() < 0.03 * torch.stack(moved).mean()


def bound(cfg: Any) -> None:
    """Bind thigh and calf of Go1's left front leg to each other."""

    def spec() -> mujoco.MjSpec:
        edited = usual()
        bond = edited.add_tendon(stiffness=5.0)
        for joint in ("FL_thigh_joint", "FL_calf_joint"):
            bond.wrap_joint(joint, 1.0)
        return edited

    robot = cfg.scene.entities["robot"]
    usual, robot.spec_fn = robot.spec_fn, spec


def test_a_robot_whose_left_and_right_differ_is_refused():
    env = calm(GO1, 1)
    with pytest.raises(MorlaxError, match=r"center of mass of robot/trunk .*-tolerance 0\.01\."):
        mirror_of(env, ["actor", "critic"])

    def clip(cfg: Any) -> None:
        cfg.observations["actor"].terms["base_lin_vel"].clip = (-1.0, 2.0)

    with pytest.raises(MorlaxError, match="differ in clip or scale of the observation base_lin"):
        mirror_of(calm(GO1, 1, edit=clip), ["actor", "critic"], tolerance=0.01)
    env.sim.mj_model.jnt_pos[env.sim.mj_model.joint("robot/FL_hip_joint").id, 1] += 0.05
    with pytest.raises(MorlaxError, match="FR_hip_joint has no mirrored partner on the robot"):
        mirror_of(env, ["actor", "critic"])
    with pytest.raises(MorlaxError, match="accelerate differently, such as by a tendon"):
        mirror_of(calm(GO1, 1, edit=bound), ["actor", "critic"], tolerance=0.01)
    other = envs.make(CARTPOLE, 1, "cpu")
    with pytest.raises(MorlaxError, match=r"the mirror image of the observation .* is not known"):
        other.mirror()


def harder(cfg: Any) -> None:
    """Let robots go from level to level of uneven ground, and act late; draw nothing else."""
    cfg.curriculum = {"levels": worlds.load(ROUGH).curriculum["terrain_levels"]}
    import_module("morlax_torch.envs.bridges.mjlab.robust").harden(cfg)
    cfg.events = {key: event for key, event in cfg.events.items() if event.mode != "startup"}


def drift(cfg: Any) -> None:
    """Let the first term that actors observe be a little larger in each episode."""
    noise, actor = import_module("mjlab.utils.noise"), cfg.observations["actor"]
    none, more = noise.ConstantNoiseCfg(bias=0.0), noise.ConstantNoiseCfg(bias=0.1)
    actor.enable_corruption = True
    for term in actor.terms.values():
        term.noise = None
    first = next(iter(actor.terms.values()))
    first.noise = noise.NoiseModelWithAdditiveBiasCfg(noise_cfg=none, bias_noise_cfg=more)


def fixed(like: torch.Tensor, most: int) -> torch.Tensor:
    """Return the lags of three worlds, or the level of ground after the last one."""
    return 3 * torch.arange(3, device=like.device) if most == 9 else torch.full_like(like, 4)


@pytest.mark.parametrize("name", [GO1, G1, ROUGH])
def test_a_step_that_can_be_recorded_equals_mjlab_s(name, generator, monkeypatch):
    def limited(cfg: Any) -> None:
        (action,) = cfg.actions.values()
        action.clip = {".*": (-0.5, 0.5)}
        drift(cfg)
        if name == ROUGH:
            harder(cfg)

    monkeypatch.setattr(torch, "randint_like", fixed)
    options = {"pushed": True, "edit": limited, "episode_length_s": 0.4}
    own, ours = (calm(name, 3, **options) for _ in range(2))
    for env in (own, ours) if name == ROUGH else ():
        terrain, none = env.scene.terrain, torch.zeros(3, dtype=torch.bool)
        terrain.terrain_levels[:] = torch.tensor([4, 9, 9])
        terrain.update_env_origins(torch.arange(3), none, none)
        env.reset()
        ground = terrain.cfg.terrain_generator
        ground.size, ground.border_width = (0.06, 0.06), 100.0  # m; half a size is far
    ages = torch.tensor([0, 7, 13])  # of episodes of 20 steps
    for env in (own, ours):
        env.episode_length_buf.copy_(ages)
    step, feet = MaskedStep(ours, ("actor", "critic")), 2 if name == G1 else 4
    climbs: list[torch.Tensor] = []
    for _ in range(30):  # the third world restarts twice
        action = 0.3 * torch.randn(3, own.action_manager.total_action_dim, generator=generator)
        groups, _, terminated, timed_out, _ = own.step(action)
        seen, ending, failed, late = step(action)
        # mjlab reads contacts anew only in steps in which some world restarts
        known = slice(None) if (terminated | timed_out).any() else slice(0, -4 * feet)
        assert torch.equal(groups["actor"], seen["actor"])
        assert torch.equal(groups["critic"][:, known], seen["critic"][:, known])
        rewards = own.reward_manager._step_reward, ours.reward_manager._step_reward
        torch.testing.assert_close(*rewards, rtol=0, atol=1e-5 if name == ROUGH else 0)
        assert torch.equal(terminated, failed) and torch.equal(timed_out, late)
        over = terminated | timed_out
        assert (ending["actor"] != seen["actor"]).any(1)[over].all()
        if name == ROUGH:
            climbs.append(own.scene.terrain.terrain_levels.clone())
            assert torch.equal(climbs[-1], ours.scene.terrain.terrain_levels)
            assert torch.equal(own.scene.terrain.env_origins, ours.scene.terrain.env_origins)
    moved = torch.stack(climbs).diff(dim=0).unique().tolist() if climbs else [-1, 0, 1]
    assert moved == [-1, 0, 1]


def test_a_body_that_events_move_is_moved_by_restarts_alone(monkeypatch):
    entity, managers = import_module("mjlab.entity"), import_module("mjlab.managers")
    registry = import_module("mjlab.tasks.registry")
    usual, start = registry.load_env_cfg, import_module("mjlab.envs.mdp").reset_root_state_uniform

    def ball() -> mujoco.MjSpec:
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name="ball", mocap=True)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0])
        return spec

    def with_ball(task: str) -> Any:
        cfg = usual(task)
        params = {"pose_range": {"x": (5, 6)}, "asset_cfg": managers.SceneEntityCfg("ball")}
        event = managers.EventTermCfg(mode="reset", func=start, params=params)
        cfg.scene.entities["ball"], cfg.events["ball"] = entity.EntityCfg(spec_fn=ball), event
        return cfg

    monkeypatch.setattr(registry, "load_env_cfg", with_ball)
    env = envs.make(GO1, 4, "cpu", episode_length=7)
    places = env.env.sim.data.mocap_pos
    for _ in range(9):
        before, step = places.clone(), env.step(noise(env))
        moved = (places[:] != before).flatten(1).any(1)
        assert torch.equal(moved, step.terminated | step.truncated)
    player = Player(load("go1"), (1, 0, 0))
    assert 5 < player.data.mocap_pos[0, 0] < 6  # a viewer shows it where it is


@pytest.mark.parametrize("name", [GO1, ROUGH])
def test_rollouts_and_evaluations_can_be_recorded(name, monkeypatch):
    check_recordable(tiny(name, backend=None, **FEW), monkeypatch)


def test_robust_worlds_differ_and_their_actions_arrive_late(monkeypatch, generator):
    env = envs.make(GO1, 32, "cpu", robust=True, auto_reset=False, history={"joint_*": 2})
    env.reset()
    sim, late = env.env.sim, env.env.action_manager.get_term("joint_pos")
    lags, applied, physics = late._lag.clone(), [], sim.step
    monkeypatch.setattr(sim, "step", lambda: (applied.append(sim.data.ctrl[:].clone()), physics()))
    start, targets = late._offset, []
    for _ in range(6):
        action = torch.rand(32, env.action_size, generator=generator)
        env.step(action)
        targets.append(start + action * late._scale)
    assert lags.unique().tolist() == [*range(9)]  # physics steps of 5 ms: 0 to 40 ms
    robot, model = env.env.scene["robot"], sim.mj_model
    joints = [model.joint(f"robot/{name}").id for name in robot.joint_names]
    controls = [model.actuator_trnid[:, 0].tolist().index(joint) for joint in joints]
    for world, lag in enumerate(lags.tolist()):
        for number, ctrl in enumerate(applied):  # four of each control step
            sent = (number - lag) // 4
            target = (start if sent < 0 else targets[sent])[world] - robot.data.encoder_bias[world]
            torch.testing.assert_close(ctrl[world, controls], target)
    env.reset()
    assert (late._lag != lags).any()

    trunk = model.body("robot/trunk").id
    columns = [  # of the model, and the largest share by which they differ
        ("body_mass", trunk, 0.15),
        ("actuator_gainprm", (slice(None), 0), 0.2),
        ("actuator_biasprm", (slice(None), 2), 0.2),
        ("actuator_forcerange", (slice(None), 1), 0.2),
    ]
    for name, column, span in columns:
        usual = torch.from_numpy(getattr(model, name)).float()[column]
        apart = getattr(sim.model, name)[:].view(32, *getattr(model, name).shape)
        column = column if isinstance(column, tuple) else (column,)
        ratio = apart[(slice(None), *column)] / usual - 1
        assert (ratio.abs() < span + 1e-4).all() and ratio.min() < -0.8 * span < 0
        assert ratio.max() > 0.8 * span and len(ratio.flatten().unique()) >= 32
    push = env.env.event_manager.get_term_cfg("push_robot").params["velocity_range"]
    assert push["x"] == (-0.75, 0.75)


def test_uneven_ground_is_recorded_and_exports_stand_on_a_plane():
    robot = envs.make_robot(ROUGH, robust=True)
    assert type(robot.env.action_manager.get_term("joint_pos")).__name__ == "JointPositionAction"
    model = mujoco.MjSpec.from_zip(io.BytesIO(robot.deployment().model)).compile()
    on_ground = model.geom_bodyid == model.body("terrain").id
    assert model.nhfield == 0
    assert model.geom_type[on_ground].tolist() == [mujoco.mjtGeom.mjGEOM_PLANE]
    for name in (ROUGH, ROUGH.replace("Go1", "G1")):
        config, _, _ = read(["--env", name, "--device", "cpu"])
        assert config.task.robust and config.task.curriculum and config.task.sensors == "real"
        assert worlds.supported(worlds.changed(name, config.task, 2, 0))
    with pytest.raises(MorlaxError, match=r"no command of velocity: leave task\.robust out"):
        envs.make(CARTPOLE, 1, "cpu", robust=True)
    with pytest.raises(MorlaxError, match=r"follows no motion: leave task\.motion_file out"):
        envs.make(CARTPOLE, 1, "cpu", motion_file="dance.npz")


def test_worlds_that_share_a_trade_off_walk_on_all_kinds_of_ground():
    terrain = envs.make(ROUGH, 60, "cpu", curriculum=True).env.scene.terrain
    assert all(len(cluster.unique()) == 7 for cluster in terrain.terrain_types.view(3, 20))
    numbers = torch.bincount(terrain.terrain_types)
    assert (numbers / 60 - torch.tensor([0.2] * 3 + [0.1] * 4)).abs().max() < 0.03
    places = terrain.terrain_origins[terrain.terrain_levels, terrain.terrain_types]
    assert torch.equal(terrain.env_origins, places)


def late(cfg: Any) -> None:
    robot = cfg.scene.entities["robot"]
    motors = [replace(motor, delay_max_lag=2) for motor in robot.articulation.actuators]
    robot.articulation = replace(robot.articulation, actuators=tuple(motors))


def shaken(cfg: Any) -> None:
    cfg.events["shake"] = replace(cfg.events["push_robot"], mode="step")


def sanitized(cfg: Any) -> None:
    cfg.observations["actor"].nan_policy = "sanitize"


def remembering(cfg: Any) -> None:
    cfg.observations["critic"].terms["joint_pos"].history_length = 2


@pytest.mark.parametrize("change", [late, shaken, sanitized, remembering])
def test_mjlab_s_own_step_does_what_a_recorded_one_cannot(change):
    cfg = worlds.load(GO1)
    cfg.curriculum = {}
    assert worlds.supported(cfg)
    change(cfg)
    assert not worlds.supported(cfg)


@pytest.mark.gpu
@pytest.mark.parametrize("name", [GO1, G1, ROUGH])
def test_a_recorded_step_follows_mjlab_s(name, generator, monkeypatch):
    monkeypatch.setattr(torch, "randint_like", fixed)
    edits = {"edit": harder} if name == ROUGH else {}
    options = {"pushed": True, "episode_length_s": 0.4, **edits}
    own, ours = (calm(name, 3, "cuda", **options) for _ in range(2))
    for env in (own, ours):
        env.episode_length_buf.copy_(torch.tensor([0, 7, 13]))
    check_recorded_step(own, ours, 45, generator)


def test_commands_that_our_step_draws_are_distributed_like_mjlab_s(monkeypatch):
    found = []
    for ours in (True, False):
        monkeypatch.setattr(worlds, "supported", lambda *_, answer=ours: answer)
        go1 = envs.make(GO1, 256, "cpu", seed=3)
        go1.step(torch.zeros(256, 12))
        go1.env.episode_length_buf.fill_(go1.episode_length - 1)
        step = go1.step(torch.zeros(256, 12))
        assert step.truncated.all()
        term = go1.env.command_manager.get_term("twist")
        shares = [
            getattr(term, f"is_{kind}_env").float().mean()
            for kind in ("standing", "heading", "world", "forward")
        ]
        command = term.command[~(term.is_heading_env | term.is_standing_env)]
        spread = [*command.mean(0), *command.std(0), term.time_left.mean(), term.time_left.std()]
        found.append(torch.stack([*shares, *spread]))
        if ours:  # also a reset leaves numbers where the recorded step reads them
            go1.reset()
            assert all(holder[key] is value for holder, key, value in go1._step.slots)
    torch.testing.assert_close(found[0], found[1], rtol=0.1, atol=0.1)


@pytest.mark.parametrize("name", [GO1, ROUGH])
def test_worlds_of_the_same_episode_draw_alike_whatever_their_number(name):
    options = {"commands": {"twist.lin_vel_x": (-2.0, 2.0)}, "robust": name == ROUGH}
    few, go1 = (envs.make(name, number, "cpu", auto_reset=False, **options) for number in (2, 6))
    few.share_draws(torch.arange(2), 2)
    go1.share_draws(torch.arange(6) // 3, 2)
    for each in (few, go1):
        each.reseed(1)
    alone = few.reset()
    seen = go1.reset()
    for _ in range(12):
        one, other = alone
        # worlds stand in different places, which rounds differently
        torch.testing.assert_close(seen, torch.stack([one] * 3 + [other] * 3), atol=0.01, rtol=0)
        assert (one - other).abs().max() > 0.3
        for each in (few, go1):  # draw new commands sooner
            each.env.command_manager.get_term("twist").time_left -= 1.0
        alone = few.step(torch.zeros(2, 12)).observation
        seen = go1.step(torch.zeros(6, 12)).observation
    drawn = [go1.env.sim.model.geom_friction, go1.env.sim.model.body_ipos]
    if name == ROUGH:
        late = go1.env.action_manager.get_term("joint_pos")
        drawn += [go1.env.sim.model.body_mass, late._lag, go1.env.scene.terrain.env_origins]
    for values in drawn:
        assert (values[0] == values[2]).all() and (values[0] != values[3]).any()
    assert (few.env.sim.model.body_ipos[1] == go1.env.sim.model.body_ipos[3]).all()


@pytest.mark.parametrize("name", ["g1", "g1-tour"])
def test_without_a_gpu_the_best_of_the_front_is_chosen(name):
    front = load_front(name)
    choice = choose(name, {}, "speed (m/s)", at_most={"power": 35.0}, margin=0.0, device="cpu")
    assert choice.simulated == 0
    measured = dict(zip(front.quantity_names, front.quantities.T, strict=True))
    speed, power = measured["speed (m/s)"], measured["power (W)"]
    best = np.where(power <= 35.0, speed, 0.0).argmax()
    assert choice.tradeoff == pytest.approx(front.tradeoffs[best], abs=1e-4)
    assert choice.quantities["speed (m/s)"] == pytest.approx(speed[best])


def test_evaluations_measure_velocity_power_and_cost_of_transport(monkeypatch):
    policy = load("go1")
    config = policy.config.with_task(episode_length=40)
    front = evaluate(Policy(policy.agent, config, policy.objectives), 3, device="cpu", seeds=4)
    error, turning, speed, share, power, torque, cost, *others = front.quantities.T
    hottest, shaken, landing, uneven, drift, falls = others
    np.testing.assert_allclose(falls, 1000 * front.falls / front.lengths)
    assert front.quantity_names == worlds.QUANTITIES and len(error) == 3
    assert ((hottest > torque / 35.55) & (hottest < 1)).all() and not (drift > speed).any()
    assert ((shaken > 1) & (shaken < 100)).all()
    assert ((error > 0) & (error < 1.5) & (speed > 0) & (speed < 1.5) & (torque < 24)).all()
    effort, tracking = map(policy.objectives.index, ("effort", "tracking"))
    assert share.max() > 0.5 and share.argmax() == tracking and power.argmin() == effort
    assert 0 < turning[tracking] < 0.5
    assert ((landing > 0.1) & (landing < 3)).all() and ((uneven > 0) & (uneven < 0.5)).all()
    assert (share < 1.2).all()
    weight = 9.81 * 12.7  # of a Go1, about 12.7 kg in mjlab
    np.testing.assert_allclose(cost, power / weight / speed, rtol=0.1)

    monkeypatch.setattr(worlds, "supported", lambda *_: False)  # mjlab's own step has metrics
    env = envs.make(GO1, 2, "cpu")
    term = env.env.command_manager.get_term("twist")
    term.time_left.fill_(1e9)
    for kind in ("heading", "standing", "world"):
        getattr(term, f"is_{kind}_env").zero_()
    nothing = env.quantify(np.zeros((1, env.measure().shape[1])), np.zeros(1))[0]
    unknown = [name.split(" (")[0] for name in np.array(env.quantities)[np.isnan(nothing)]]
    assert unknown == ["speed", "landing force", "drift"]  # speed as a share of the commanded one
    names = "error_vel_xy", "error_vel_yaw"
    for name in names:
        term.metrics[name].zero_()
    errors = torch.zeros(2, 2)
    for _ in range(5):
        env.step(noise(env))
        errors += env.measure()[:, :2]
    steps = term.cfg.resampling_time_range[1] / env.env.step_dt  # by which mjlab divides
    metrics = torch.stack([term.metrics[name] for name in names], 1)
    torch.testing.assert_close(metrics * steps, errors)


def test_torque_is_limited_by_motors_and_by_joints():
    limits = {"hip": 'actuatorfrcrange="-3 3"', "knee": 'actuatorfrcrange="-3 3"', "toe": ""}
    joints = "".join(f'<joint name="{name}" {limit}/>' for name, limit in limits.items())
    body = f'<body>{joints}<geom size="1"/></body>'
    motors = '<motor joint="hip"/><motor joint="knee" gear="2" forcerange="-1 1"/>'
    text = f"<mujoco><worldbody>{body}</worldbody><actuator>{motors}</actuator></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    assert torque_limits(model).tolist() == [3.0, 2.0, np.inf]


def test_actors_observe_what_sensors_measure_and_some_of_the_past(generator):
    plain = envs.make(GO1, 2, "cpu", seed=3, episode_length=6, stagger=False)
    options = {"sensors": "real", "history": {"joint_*": 3, "command": 2}}
    env = envs.make(GO1, 2, "cpu", seed=3, episode_length=6, stagger=False, **options)
    manager = plain.env.observation_manager
    names, dims = manager.active_terms["actor"], manager.group_obs_term_dim["actor"]
    sizes = {name: torch.Size(dim).numel() for name, dim in zip(names, dims, strict=True)}
    lengths = {"base_lin_vel": 0, "joint_pos": 3, "joint_vel": 3, "command": 2}
    assert env.observation_size == sum(lengths.get(name, 1) * size for name, size in sizes.items())
    assert env.privileged_size == plain.privileged_size
    frames: list[dict[str, torch.Tensor]] = []

    def split(observation: torch.Tensor) -> dict[str, torch.Tensor]:
        return dict(zip(sizes, observation.split([*sizes.values()], 1), strict=True))

    def expected(past: list[dict[str, torch.Tensor]]) -> torch.Tensor:
        past = [past[0]] * 3 + past  # the first observation stands for those before it
        of_terms = [past[-number:] for name in sizes if (number := lengths.get(name, 1))]
        kept = [name for name in sizes if lengths.get(name, 1)]
        return torch.cat(
            [row[name] for name, rows in zip(kept, of_terms, strict=True) for row in rows], 1
        )

    frames.append(split(plain.reset()))
    assert torch.equal(env.reset(), expected(frames))
    for number in range(1, 9):
        action = 0.3 * torch.randn(2, env.action_size, generator=generator)
        torch.manual_seed(number)
        one = plain.step(action)
        torch.manual_seed(number)
        other = env.step(action)
        assert torch.equal(
            one.critic_observation[:, -env.privileged_size :],
            other.critic_observation[:, -env.privileged_size :],
        )
        assert torch.equal(
            other.final_observation, expected([*frames, split(one.final_observation)])
        )
        if number == 6:
            assert one.truncated.all()
            frames.clear()
        frames.append(split(one.observation))
        assert torch.equal(other.observation, expected(frames))


def test_on_a_tour_others_move_the_arms_and_punch(generator):
    env = envs.make(TOUR, 64, "cpu", stagger=False, episode_length=300)
    model, harness = env.env.sim.mj_model, env.env.action_manager.get_term("harness")
    robot, applied = env.env.scene["robot"], env.env.sim.data.xfrc_applied[:]
    owned = env.env.action_manager.get_term("joint_pos").target_names
    assert env.action_size == 15 and not any("shoulder" in name for name in owned)
    assert harness.level.min() == 1
    env.reset()
    skipped, forces, ranges = harness._skipped.clone(), [], robot.data.joint_pos_limits
    ahead = (harness._after - harness._before).abs().mean(1)  # rad
    assert ahead[skipped > 40].mean() > 2 * ahead[skipped < 10].mean() > 0
    for step in range(12):
        state = env.env.sim.data.qpos[:].clone()
        after = env.step(0.2 * torch.randn(64, 15, generator=generator))
        forces.append(applied[..., :3].norm(dim=2))
        if step == 6:  # of the punch: it pushes at a joint
            data, world = mujoco.MjData(model), 3
            data.qpos[:] = state[world].numpy()
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            joint = int(harness._joints[harness._hit[world]])
            body = model.jnt_bodyid[joint]
            found, expected = np.zeros(model.nv), np.zeros(model.nv)
            push, twist = applied[world, body].double().numpy().reshape(2, 3)
            mujoco.mj_applyFT(model, data, push, twist, data.xipos[body], body, found)
            push, at = harness._force[world].double().numpy(), data.xanchor[joint]
            mujoco.mj_applyFT(model, data, push, np.zeros(3), at, body, expected)
            np.testing.assert_allclose(found, expected, atol=0.02 * np.abs(expected).max())
    sizes = torch.stack(forces).sum(2)  # of one body
    assert sizes[:5].max() == 0 and sizes[9:].max() == 0 and (sizes[5:9] > 0).all()
    ceiling = 500 * (1 / 3 + 2 / 3 * (skipped + 0.1) / 60).clamp(max=1)
    assert (sizes[5] <= ceiling * 1.001).all() and (sizes[5] >= 0.499 * ceiling).all()
    left, right = harness._targets.chunk(2, 1)
    assert torch.equal(right, left * torch.tensor([1.0, -1, -1, 1, -1, 1, -1]))
    low, high = ranges[:, harness._arms].unbind(-1)
    assert (harness._targets >= low - 1e-5).all() and (harness._targets <= high + 1e-5).all()
    arms = robot.data.joint_pos[:, harness._arms]
    assert (arms - harness._targets).abs().mean() < 0.1 and left.std() > 0.02
    with NoSync(), NoCopies():
        env._step(torch.zeros(64, 15))
    # a world that restarts draws anew, others go on
    over = after.terminated | after.truncated
    while not over.any():
        before = harness._skipped.clone()
        after = env.step(torch.ones(64, 15))
        over = after.terminated | after.truncated
    assert torch.equal(harness._skipped == before, ~over)
    assert env.mirror(0.01).action(torch.ones(15)).abs().max() == 1


def test_punches_of_a_tour_grow_with_the_episodes_that_last():
    env = envs.make(TOUR, 4, "cpu", stagger=False, episode_length=12, curriculum=True)
    harness, punches = env.env.action_manager.get_term("harness"), []
    upside_down = torch.tensor([0.0, 1.0, 0.0, 0.0])
    env.reset()
    for step in range(40):  # three episodes, in which world 0 falls again and again
        if step % 4 == 3:
            env.env.sim.data.qpos[:][: 4 if step > 36 else 1, 3:7] = upside_down
        if step % 12 == 6:
            punches.append(harness._force.norm(dim=1)[1:])
        env.step(torch.zeros(4, 15))
    assert (harness.level - torch.tensor([0, 0.5, 0.5, 0.5])).abs().max() < 1e-6
    assert punches[0].max() == 0 and (punches[1] > 0).all() and punches[1].max() <= 100
    assert punches[2].min() > 33  # N


def test_the_vibration_of_a_tour_is_that_of_its_score(generator):
    options = {"objectives": {"vibration": {"vibration": 1.0}, "alive": {"is_alive": 1.0}}}
    env = envs.make(TOUR, 2, "cpu", stagger=False, guide={}, **options)
    speeds, rewards = [], []
    env.reset()
    for _ in range(8):
        step = env.step(0.1 * torch.randn(2, 15, generator=generator))
        speeds.append(env.env.scene["robot"].data.joint_vel[0].numpy().copy())
        rewards.append(float(step.reward[0, 0]))
    _, vibration = costs(np.zeros((8, 29)), np.array(speeds), env.dt)
    assert not (step.terminated | step.truncated).any()
    assert sum(rewards) == pytest.approx(1e6 * vibration * env.dt, rel=1e-4)


@pytest.mark.parametrize(("name", "level"), [(TOUR, 0.6), (ROUGH, 3)])
def test_a_resumed_run_goes_on_at_its_levels_of_difficulty(name, level):
    resumed = learner(tiny(name, backend=None, **FEW))
    (levels,), env = resumed.env._levels(), resumed.env.env
    levels.fill_(level)
    state = resumed.state_dict()
    levels.zero_()
    resumed.load_state_dict(state)
    assert (levels == level).all()
    assert torch.equal(resumed.observation, resumed.env.critic_observation())
    places = env.sim.data.qpos[:, :2] - env.scene.env_origins[:, :2]
    assert places.abs().max() <= 0.5  # m
    if name == ROUGH:
        ground = env.scene.terrain
        assert torch.equal(env.scene.env_origins, ground.terrain_origins[3, ground.terrain_types])
    resumed.load_state_dict({**state, "environment": {}})  # of an earlier version
