"""Episodes end, restart and repeat the way a learner requires."""

from unittest.mock import Mock

import mujoco
import numpy as np
import pytest
import torch
import warp as wp
from acting import random_actions, still
from crowd import Crowd
from same import assert_same, reference
from torch import Tensor

from morlax_torch import MorlaxError, envs
from morlax_torch.envs.worlds import checks
from morlax_torch.envs.worlds.episodes import Start, around

BUILT_IN = [name for name in envs.names() if "/" not in name]
SINGLE = 1e-5  # largest difference between single precision and C MuJoCo's forward pass


def make(task: str, backend: str, worlds: int = 3, **options) -> envs.Environment:
    return envs.make(task, worlds, "cpu", backend=backend, **options)


def forward(model: mujoco.MjModel, qpos: Tensor, qvel: Tensor) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos, data.qvel = qpos.double().numpy(), qvel.double().numpy()
    mujoco.mj_forward(model, data)
    return data


def test_actions_of_another_shape_or_type_are_one_sentence():
    env = envs.make("hopper", 2, "cpu")
    before, A = env.reset(), env.action_size
    wrong = [torch.zeros(shape) for shape in ((A,), (1, A), (2, A + 1), (2, 1, A))]
    wrong += [torch.zeros(2, A, dtype=torch.int64), torch.zeros(2, A, device="meta")]
    for action in wrong:
        with pytest.raises(MorlaxError, match=rf"step needs actions of shape \(2, {A}\) .* not "):
            env.step(action)
    with pytest.raises(MorlaxError, match=r"as a torch\.Tensor, not ndarray"):
        env.step(np.zeros((2, A)))
    assert torch.equal(env.critic_observation(), before)
    env.step(torch.zeros(2, A, dtype=torch.float64))


def test_torch_s_defaults_change_no_step(backend, dtypes):
    steps = []
    for _ in dtypes:
        random = {"friction": (0.5, 1.5), "push": 0.5, "push_every": 2, "action_delay": (0, 2)}
        env = make("ant", backend, reset_noise=0.01, randomization=random)
        action = torch.full((3, env.action_size), 0.3, device="cpu")
        steps.append([list(env.step(action)[:5]) for _ in range(5)])
    assert_same(*steps)
    assert steps[1][-1][1].dtype == torch.float32


def test_an_episode_is_truncated_at_its_full_length(backend):
    env = make("cheetah", backend, episode_length=4)
    for age in (1, 2, 3):
        step = env.step(still(env))
        assert not (step.truncated | step.terminated).any()
        assert env.age.tolist() == [age] * 3
    step = env.step(still(env))
    assert step.truncated.all()
    assert not step.terminated.any()
    assert env.age.tolist() == [0, 0, 0]
    assert not env.step(still(env)).truncated.any()


def test_a_failure_ends_only_its_own_world_s_episode_and_still_pays_rewards(backend):
    env = make("cheetah", backend)
    env.step(still(env))
    env.physics.qpos[1, 2] = 2.0  # radians: tipping onto its back
    step = env.step(still(env))
    assert step.terminated.tolist() == [False, True, False]
    assert not step.truncated.any()
    assert env.age.tolist() == [2, 0, 2]
    assert step.reward[1, 1] == 5.0  # alive, with zero actions
    assert env.blowups == 0


def test_failing_on_the_last_step_terminates_instead_of_truncating(backend):
    env = make("cheetah", backend, episode_length=2)
    env.step(still(env))
    env.physics.qpos[1, 2] = 2.0
    step = env.step(still(env))
    assert step.terminated.tolist() == [False, True, False]
    assert step.truncated.tolist() == [True, False, True]
    assert env.age.tolist() == [0, 0, 0]


def test_without_auto_reset_an_episode_continues_after_its_end(backend):
    env = make("hopper", backend, episode_length=2, auto_reset=False)
    ends = []
    for _ in range(3):
        step = env.step(still(env))
        ends.append(step.truncated.all().item())
        assert torch.equal(step.observation, env.observe().float())
    assert ends == [False, True, True]
    assert env.age.tolist() == [3, 3, 3]


@pytest.mark.parametrize("task", BUILT_IN)
def test_no_state_carries_over_between_episodes(task, backend):
    length = 40  # long enough for some random robots to fail, not all
    env = make(task, backend, episode_length=length)
    script = random_actions(env, length)
    worlds = torch.arange(env.num_worlds)

    episodes: list[list[list[Tensor]]] = [[[]] for _ in worlds]
    for _ in range(2 * length):
        step = env.step(script[env.age.long(), worlds])  # every episode repeats the same actions
        ends = step.terminated | step.truncated
        seen = torch.cat([step.observation, step.reward, step.final_observation], -1)
        for world in worlds:
            episodes[world][-1].append(seen[world])
            if ends[world]:
                episodes[world].append([])

    for first, *later in episodes:  # the first episode has no predecessor
        assert len(later) >= 2
        for episode in later:
            assert all(map(torch.equal, episode, first))
        assert all(len(episode) == len(first) for episode in later[:-1])


MEMBERS = mujoco.mjtState.__members__
STATES = {  # by its name in MjData
    {"warmstart": "qacc_warmstart"}.get(name, name): member
    for member in MEMBERS
    if member.startswith("mjSTATE_") and int(MEMBERS[member]).bit_count() == 1
    for name in [member.removeprefix("mjSTATE_").lower()]
    if name != "plugin"  # refused, see below
}
YIELDING = 'springyield="0.05"' if "plastic" in STATES else ""
EVERYTHING = f"""
<mujoco>
  <option timestep="0.01"/>
  <size nuserdata="2"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body name="target" mocap="true" pos="0.3 0 1"/>
    <body name="free" pos="1 0 0.5"><freejoint/><geom size="0.1"/></body>
    <body pos="0 0 1">
      <joint name="hinge" axis="0 1 0" stiffness="5" {YIELDING}/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0" mass="0.2"/>
    </body>
  </worldbody>
  <equality><weld body1="free" body2="target" active="false"/></equality>
  <actuator>
    <motor joint="hinge" nsample="4" delay="0.03"/>
    <general joint="hinge" dyntype="filter" dynprm="0.1"/>
  </actuator>
  <sensor>
    <clock name="time"/><jointpos joint="hinge" nsample="3" delay="0.02"/>
    <framepos name="target" objtype="xbody" objname="target"/>
  </sensor>
</mujoco>
"""


class Everything(Crowd):
    """A robot that has every part of MuJoCo's state but plugins'."""

    class Options(envs.TaskOptions):
        objectives: dict[str, dict[str, float]] = {"go": {"go": 1.0}, "wait": {"wait": 1.0}}
        episode_length: int = 6

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(EVERYTHING)

    def observe(self) -> Tensor:
        return torch.cat([super().observe(), self.physics.sensors], -1)

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.add_(action)  # so that the control is state too

    def terms(self) -> dict[str, Tensor]:
        return {"go": self.physics.qvel[:, -1], "wait": self.physics.sensor("time")[:, 0]}


def everything(backend: str, task: type[Everything] = Everything) -> envs.Environment:
    options, cpu = task.Options(), torch.device("cpu")
    kind = {"auto_reset": True, "deterministic": False}
    return task.build(options, 2, cpu, backend, 0, **kind)


def of_simulator(env: envs.Environment, field: str) -> Tensor:
    """Return a view (N, ...) of a field of MjData in the simulator itself."""
    if env.simulator == "C MuJoCo":
        return torch.from_numpy(env.physics._batch.bind(field))
    return wp.to_torch(getattr(env.physics._data, field))


def disturb(values: Tensor) -> None:
    values.copy_(values + 1.0 if values.is_floating_point() else ~values)


@pytest.mark.parametrize("field", STATES)
def test_an_episode_starts_like_that_of_a_new_world(field, backend):
    env, new = everything(backend), everything(backend)
    found, fresh = of_simulator(env, field), of_simulator(new, field)
    for end in ("restart", "reset", "time"):
        disturb(found)
        assert not torch.equal(found[0], fresh[0])
        if end == "restart":
            before = found[1].clone()
            env.restart(torch.tensor([True, False]))
            assert torch.equal(found[1], before)
            assert torch.equal(found[0], fresh[0])
            continue
        if end == "time":
            env.age.fill_(env.episode_length - 1)
            env.step(still(env))
        else:
            env.reset()
        assert torch.equal(found, fresh), end


class Bare(Everything):
    """A task that observes nothing but the simulator's own memory."""

    def observe(self) -> Tensor:
        return self.physics.qpos


def test_observations_do_not_change_with_the_worlds(backend):
    env = everything(backend, Bare)
    seen = [env.reset(), env.step(still(env) + 1).observation]
    before = [values.clone() for values in seen]
    env.step(still(env) + 1)
    assert_same(seen, before)


def test_episodes_repeat_themselves_and_resume_exactly(backend):
    env, other = everything(backend), everything(backend)
    for field in ("userdata", "xfrc_applied", "qfrc_applied", "mocap_pos", "eq_active"):
        disturb(of_simulator(env, field))  # which only users change
    action = torch.tensor([[0.5, 0.2], [-0.3, 0.1]])
    for _ in range(4):
        env.step(action)
    saved = env.state_dict()
    steps = [env.step(action) for _ in range(14)]
    other.load_state_dict(saved)
    for step in steps:
        assert_same(other.step(action)._asdict(), step._asdict())
    for first, second in zip(steps[2:8], steps[8:], strict=True):
        assert torch.equal(first.final_observation, second.final_observation)
        assert torch.equal(first.reward, second.reward)


def test_state_moves_between_simulators():
    env, other = everything("mujoco"), everything("warp")
    for field in STATES:
        disturb(of_simulator(env, field))
    for target in (other, everything("mujoco")):
        target.load_state_dict(env.state_dict())
        for field in STATES:
            same = of_simulator(target, field).double(), of_simulator(env, field).double()
            torch.testing.assert_close(*same, rtol=1e-6, atol=1e-6)
        env = target


def test_the_state_of_another_number_of_worlds_is_refused():
    one, two = envs.make("hopper", 1, "cpu"), envs.make("hopper", 2, "cpu")
    for env, other in ((one, two), (two, one)):
        with pytest.raises(MorlaxError, match="the saved worlds are another number"):
            env.load_state_dict(other.state_dict())


def test_tasks_move_mocap_bodies_and_name_other_parts_of_the_state(backend):
    env = everything(backend)
    env.physics.part("mocap_pos")[0, 0, 2] = 3.0
    step = env.step(still(env))
    assert env.physics.sensor("target")[:, 2].tolist() == [3.0, 1.0]
    assert step.observation[0, -1] == 3.0
    assert env.physics.part("time").shape == (2,)
    assert env.restart(torch.ones(2, dtype=torch.bool))[0, -1] == 1.0
    with pytest.raises(MorlaxError, match=r"unknown part of the state 'mocap'.* mocap_pos"):
        env.physics.part("mocap")


def test_state_that_no_reset_restores_is_refused(monkeypatch, backend):
    sleepy = EVERYTHING.replace('timestep="0.01"/>', '><flag sleep="enable"/></option>')
    model = mujoco.MjModel.from_xml_string(sleepy)
    monkeypatch.setattr(Everything, "load_model", lambda: model)
    with pytest.raises(MorlaxError, match=r"Everything: its model lets bodies sleep, .* remove"):
        everything(backend)
    # no plugin that comes with MuJoCo has a state
    plugins = Mock(spec=mujoco.MjModel, npluginstate=2)
    with pytest.raises(MorlaxError, match=r"Everything: its model has plugins .* remove"):
        checks.model(Everything, plugins)


def test_staggered_worlds_start_at_different_ages(backend):
    options = {"episode_length": 100, "stagger": True}
    env = make("hopper", backend, 256, **options)
    ages = env.age.clone()
    assert ages.min() < 10 and 90 <= ages.max() < 100 and len(ages.unique()) > 50
    assert torch.equal(make("hopper", backend, 256, **options).age, ages)
    assert not torch.equal(make("hopper", backend, 256, seed=1, **options).age, ages)

    step = env.step(still(env))
    assert torch.equal(step.truncated, ages == 99)
    assert (env.age[step.truncated] == 0).all()  # later episodes have full length


def test_reset_noise_has_the_configured_size(backend):
    noise = 0.05
    env = make("humanoid", backend, 64, reset_noise=noise)
    qpos, qvel = env.physics.qpos, env.physics.qvel
    assert len(qpos.unique(dim=0)) > 55
    exact = make("humanoid", backend, 1).physics.qpos
    shift = (qpos - exact)[:, [0, 1, 2, *range(7, qpos.shape[1])]]
    assert shift.abs().max() <= noise * 1.001
    assert shift.std().item() == pytest.approx(noise / 3**0.5, rel=0.1)
    assert qvel.std().item() == pytest.approx(noise, rel=0.1)
    torch.testing.assert_close(qpos[:, 3:7].norm(dim=-1), torch.ones(64).to(qpos))


def test_sensors_match_the_noisy_initial_state(backend):
    env = make("humanoid", backend, 8, reset_noise=0.05, episode_length=2)
    for action in (None, *random_actions(env, 2)):
        observation = env.reset() if action is None else env.step(action).observation
        if env.age.any():
            continue
        for world in range(env.num_worlds):
            data = forward(env.physics.model, env.physics.qpos[world], env.physics.qvel[world])
            sensors = env.physics.sensors[world]
            np.testing.assert_allclose(sensors, data.sensordata, rtol=0, atol=SINGLE)
            head = data.body("head").xpos[2]
            assert observation[world, 21].item() == pytest.approx(head, abs=SINGLE)


CLOSED = """
<mujoco>
  <worldbody>
    <body pos="0 0 1"><joint name="a" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.2"/>
      <body pos="0 0 -0.4"><joint name="b" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>
        <body pos="0.4 0 0"><joint name="c" axis="0 1 0"/><geom size="0.1" pos="0 0 0.2"/>
          <site name="end" pos="0 0 0.4"/>
        </body>
      </body>
    </body>
    <body pos="0.4 0 1"><site name="anchor"/></body>
    <body pos="0 2 1"><joint name="one" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
    <body pos="0 3 1"><joint name="other" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
    <body name="held" pos="0 4 1"><freejoint/><geom size="0.1"/></body>
    <body name="holder" pos="0 4 1.1"><joint name="d" axis="1 0 0"/><geom size="0.1"/></body>
    <body name="far" mocap="true" pos="0 9 1"/>
    <body name="pulled" pos="0 8 1"><freejoint/><geom size="0.1"/></body>
  </worldbody>
  <equality>
    <connect site1="end" site2="anchor"/>
    <joint joint1="one" joint2="other" polycoef="0 2 0 0 0"/>
    <weld body1="held" body2="holder"/>
    <weld body1="pulled" body2="far" relpose="0 0 0 1 0 0 0"/>
  </equality>
  <actuator>
    <motor joint="a"/><motor joint="a"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize("noise", (0.1, 0.5))
def test_reset_noise_keeps_loops_closed(noise):
    model = mujoco.MjModel.from_xml_string(CLOSED)
    start = Start(model.qpos0, np.zeros(model.nv), np.zeros(model.nu))
    moved = around(start.qpos, noise, model, 3, 50)
    data, turns = mujoco.MjData(model), []
    for qpos, qvel, *_ in moved:
        data.qpos, data.qvel = qpos, qvel
        mujoco.mj_forward(model, data)
        end, anchor, speed = data.site("end"), data.site("anchor"), np.zeros(6)
        np.testing.assert_allclose(end.xpos, anchor.xpos, atol=1e-6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, end.id, speed, 0)
        np.testing.assert_allclose(speed[3:], 0, atol=1e-6)
        one, other = (data.joint(name) for name in ("one", "other"))
        np.testing.assert_allclose(one.qpos, 2 * other.qpos, atol=1e-6)
        np.testing.assert_allclose(one.qvel, 2 * other.qvel, atol=1e-6)
        held, holder = data.body("held"), data.body("holder")
        apart = holder.xmat.reshape(3, 3).T @ (held.xpos - holder.xpos)
        np.testing.assert_allclose(apart, [0, 0, -0.1], atol=1e-6)
        np.testing.assert_allclose(held.xmat, holder.xmat, atol=1e-6)
        # what starts apart from its target stays there
        np.testing.assert_allclose(data.body("pulled").xpos, [0, 8, 1], atol=1e-6)
        turns.append([*data.joint("a").qpos, *other.qpos, *data.joint("d").qpos])
    assert (np.std(turns, 0) > noise / 8).all()


@pytest.mark.parametrize("iterations", (None, 8))
def test_eight_solver_iterations_converge_and_the_paper_s_two_do_not(backend, iterations):
    published = reference("walker")
    env = make("walker", backend, 2, solver_iterations=iterations, auto_reset=False)
    for action in torch.from_numpy(published["action"]).float().unbind(1):
        env.step(action)
    error = np.abs(env.physics.qpos.numpy() - published["qpos_converged"][:, -1]).max()
    assert error > 0.1 if iterations is None else error < 1e-3


def test_the_extremities_option_adds_hands_and_feet_to_the_observation(backend):
    blind, seeing = make("humanoid", backend), make("humanoid", backend, extremities=True)
    assert (blind.observation_size, seeing.observation_size) == (58, 67)
    without, with_them = blind.reset(), seeing.reset()
    assert (without[:, 22:25] == 0).all()
    assert torch.equal(with_them[:, :22], without[:, :22])
    assert torch.equal(with_them[:, 34:], without[:, 25:])

    data = forward(seeing.physics.model, seeing.physics.qpos[0], seeing.physics.qvel[0])
    torso = data.body("torso")
    expected = [
        torso.xmat.reshape(3, 3).T @ (data.body(name).xpos - torso.xpos)
        for name in ("right_hand", "left_hand", "right_foot", "left_foot")
    ]
    np.testing.assert_allclose(with_them[0, 22:34], np.concatenate(expected), atol=SINGLE)
