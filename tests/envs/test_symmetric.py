"""Policies of left-right symmetric robots."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from xml.etree import ElementTree

import mujoco
import pytest
import torch
from crowd import Crowd
from tiny import Blind, learner, tiny

from morlax_torch import MorlaxError, Policy, envs, load, save
from morlax_torch.algorithms.registry import LEARNERS
from morlax_torch.algorithms.trainer import DesignDraws
from morlax_torch.configuration.files import task_values
from morlax_torch.envs.worlds.mirror import Mirror, Reflection, check
from morlax_torch.exports.exporting import export
from morlax_torch.networks.hypernetwork import Hypernetwork
from morlax_torch.networks.mlp import Symmetric, mlp

SEEN = Reflection.of([1, 0, 2, 4, 3, 5, 6, 7, 9, 8, 10, 11, 12], [1, 1, -1, -1, -1, 1] * 2 + [1])
ACTED = Reflection.of([0, 2, 1, 3], [-1.0, 1.0, 1.0, 1.0])


class Mirrored(Blind):
    """A hopper, as if it had a left and a right."""

    def mirror(self) -> Mirror:
        return Mirror(SEEN, ACTED)


@pytest.fixture(autouse=True)
def tasks() -> None:
    envs.register("mirrored", Mirrored)


@pytest.mark.parametrize("network", ["dual", "single", "conditioned", "independent"])
def test_mirrored_observations_give_mirrored_actions_and_equal_values(tmp_path, network, generator):
    changes = {"network.symmetric": True, "network.type": network, "task.reset_noise": 0.01}
    algorithm = {"conditioned": "amor", "independent": "independent"}.get(network, "morlax")
    morlax = learner(tiny("mirrored", algorithm=algorithm, **changes), iterations=3)
    raw = 3 * torch.randn(4, 5, 13, generator=generator)
    tradeoffs = torch.rand(4, 2, generator=generator)
    normalizer, size = morlax.agent.observation_normalizer, morlax.env.observation_size
    values = morlax.agent.values(tradeoffs)
    torch.testing.assert_close(values(normalizer(SEEN(raw))), values(normalizer(raw)))
    actors, seen = morlax.agent.actors(tradeoffs), SEEN.first(size)
    mirrored, plain = (actors.distribution(x[..., :size]) for x in (SEEN(raw), raw))
    torch.testing.assert_close(mirrored.std, plain.std[..., ACTED.order])
    torch.testing.assert_close(mirrored.mode, ACTED(plain.mode))
    assert not torch.allclose(plain.mode, actors.act(seen(raw[..., :size])), atol=1e-4)

    policy = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    save(policy, tmp_path / "policy.pt")
    loaded, x = load(tmp_path / "policy.pt"), raw[0, :, :size]
    torch.testing.assert_close(loaded(seen(x), (0.3, 0.7)), ACTED(policy(x, (0.3, 0.7))))


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_every_algorithm_trains_symmetric_policies(algorithm, generator, constants):
    learning = {"method.batch": 8, "method.updates": 2} if algorithm == "hyper-sac" else {}
    constants("hyper-sac", start=32)
    changes = {"network.symmetric": True, "task.reset_noise": 0.3, **learning}
    config = tiny("mirrored", algorithm=algorithm, **changes)
    trained = learner(config)
    for iteration in range(3):
        trained.iterate(iteration / 3)
    policy = Policy(trained.agent, config, trained.env.objectives)
    size = trained.env.observation_size
    x, seen = torch.randn(16, size, generator=generator), SEEN.first(size)
    assert trained.agent.observation_normalizer.mean.any()
    torch.testing.assert_close(policy(seen(x), (0.3, 0.7)), ACTED(policy(x, (0.3, 0.7))))


@pytest.mark.parametrize(
    ("mirror", "words"),
    [
        (Mirror(SEEN.first(11), ACTED), "each of the 13 numbers of an observation"),
        (Mirror(Reflection.of([*range(1, 13), 0], [1] * 13), ACTED), "each of the 13 numbers"),
        (Mirror(SEEN, ACTED._replace(sign=SEEN.sign[3:7])), "4 numbers of an action"),
        (SEEN, "fails: "),  # one reflection alone
    ],
)
def test_a_task_s_own_mirror_is_refused_unless_two_of_it_change_nothing(mirror, words):
    envs.registry._REGISTRY["odd"] = type("Odd", (Mirrored,), {"mirror": lambda env: mirror})
    with pytest.raises(MorlaxError, match=rf"Odd\.mirror\(\) .*{words}"):
        learner(tiny("odd", **{"network.symmetric": True}))


@pytest.mark.parametrize(("format", "tradeoff"), [("torchscript", (0.5, 0.5)), ("onnx", None)])
def test_symmetric_policies_can_be_exported(tmp_path, format, tradeoff):
    morlax = learner(tiny("mirrored", **{"network.symmetric": True}), iterations=2)
    policy = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    assert export(policy, tmp_path / "policy", format, tradeoff) < 1e-5


def test_asymmetry_leads_from_symmetric_networks_to_plain_ones(generator):
    plain = mlp(13, (8,), 8, generator)
    reflections = SEEN, Reflection.joined([ACTED, ACTED._replace(sign=torch.ones(4))])
    x, tradeoffs = torch.randn(2, 5, 13, generator=generator), torch.eye(2)

    def answer(asymmetry: float) -> torch.Tensor:
        family = Hypernetwork(Symmetric(plain, *reflections, asymmetry), 2)
        rows = [family.specialize(w)(each) for w, each in zip(tradeoffs, x, strict=True)]
        found = family.run(family(tradeoffs), x)
        torch.testing.assert_close(found, torch.stack(rows))
        return found

    torch.testing.assert_close(answer(1.0), plain(x))
    torch.testing.assert_close(answer(0.3), 0.7 * answer(0.0) + 0.3 * plain(x))


FLIPPED = "abdomen_x", "abdomen_z", "ankle_x", "shoulder", "torso.y", "rot", "slider2"


@pytest.mark.parametrize(
    ("task", "tolerance"),
    [
        ("walker", 0.0),
        ("humanoid", 0.07),
        ("pgmorl/walker2d", 0.6),
        ("mo-gymnasium/humanoid", 0.1),
        ("pgmorl/swimmer", 0.0),
    ],
)
def test_a_mirror_exchanges_left_and_right_joints_and_motors(task, tolerance):
    env = envs.make(task, 1, "cpu")
    mirror, parts = env.mirror(tolerance), env.layout()
    names = [part.name for part in parts for _ in range(part.size)]
    order, sign = (values.tolist() for values in mirror.observation)
    for name, other, factor in zip(names, [names[i] for i in order], sign, strict=True):
        sides = {"right": "left", "left": "right"}
        if "walker2d" in task:
            sides = {"_left_joint": "_joint", "_joint": "_left_joint"}
        side = next((side for side in sides if side in name), "")
        assert other == name.replace(side, sides.get(side, ""), 1)
        if names.count(name) == 1:
            assert factor == (-1.0 if any(part in name for part in FLIPPED) else 1.0)
    joints = [env.physics.model.joint(i).name for i in env.physics.model.actuator_trnid[:, 0]]
    seen = [names.index(f"position.{joint}") for joint in joints]
    assert [seen[i] for i in mirror.action.order.tolist()] == [order[i] for i in seen]
    assert mirror.action.sign.tolist() == [sign[i] for i in seen]
    x = torch.randn(3, len(names))
    assert torch.equal(mirror.observation(mirror.observation(x)), x)


@pytest.mark.parametrize(
    ("task", "reason"),
    [
        ("ant", "its mirror image has other rewards of the objective vy"),
        ("bruce", "right_ankle_crank has no mirrored partner"),
        ("humanoid", r"jnt_range of right_hip_y -1\.91986, of left_hip_y -2\.0944"),
        ("pgmorl/walker2d", r"geom_friction of foot_geom 0\.9, of foot_left_geom 1\.9.*nce 0\.527"),
    ],
)
def test_robots_without_a_mirror_are_refused(task, reason):
    with pytest.raises(MorlaxError, match=reason):
        envs.make(task, 1, "cpu").mirror()


LEG = """<body name="{0}_thigh" pos="0 {1}0.08 -.1">
  <joint name="{0}_hip" axis="{2}1 0 0" range="{3}"/><joint name="{0}_swing" axis="0 {1}1 0"/>
  <geom name="{0}_thigh" type="capsule" size=".04" fromto="0 0 0 0 {1}0.02 -.25"/>
  <body name="{0}_foot" pos="0 0 -.3"><joint name="{0}_knee" axis="0 1 0" range="0 100"/>
    <geom name="{0}_foot" type="box" size=".1 .04 .02" euler="0 0 {1}10"/></body></body>"""
MOTORS = """<motor name="{0}_hip" joint="{0}_hip" gear="20"/>
  <position name="{0}_swing" joint="{0}_swing" kp="30" kv="1"/>
  <motor name="{0}_knee" joint="{0}_knee" gear="{1}15"/>"""
# The right leg has an opposite hip axis and an opposite gear, which a mirror image may have.
BIPED = f"""<mujoco><compiler autolimits="true"/><option timestep="0.005"/>
<default><joint damping="1" armature=".01"/><motor ctrlrange="-1 1"/>
<position ctrlrange="-1 1"/></default><worldbody><geom type="plane" size="9 9 .1"/>
<body name="torso" pos="0 0 .5"><freejoint/><geom name="torso" type="box" size=".1 .1 .1"/>
{LEG.format("left", "+", "+", "-20 40")}{LEG.format("right", "-", "+", "-40 20")}</body></worldbody>
<actuator>{MOTORS.format("left", "+")}{MOTORS.format("right", "-")}</actuator></mujoco>"""


class Biped(Crowd):
    """A robot with two legs, whose model a test may edit."""

    class Options(envs.TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.0}, "energy": {"effort": -1.0}}
        episode_length: int = 20

    xml: str = BIPED

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(cls.xml)

    def observe(self) -> torch.Tensor:
        return torch.cat([self.physics.qpos[:, 1:], self.physics.qvel], -1)

    def terms(self) -> dict[str, torch.Tensor]:
        return {"run": self.physics.qvel[:, 0], "effort": self.physics.ctrl.square().sum(-1)}

    def failed(self) -> torch.Tensor:
        return self.physics.qpos[:, 2] < 0.2


class Long(Biped.Options):
    episode_length: int = 1000


def mirror_of(*edits: Callable[[ElementTree.Element], object], **methods: object) -> Mirror:
    root = ElementTree.fromstring(BIPED)
    for edit in edits:
        edit(root)
    members = {"xml": ElementTree.tostring(root, "unicode"), **methods}
    envs.registry._REGISTRY["edited"] = type("Edited", (Biped,), members)
    return envs.make("edited", 1, "cpu").mirror()


def test_mirror_images_may_have_opposite_axes_and_gears():
    mirror = mirror_of()
    joints = [3, 4, 5, 0, 1, 2]  # of left and right
    assert mirror.action.order.tolist() == joints
    assert mirror.action.sign.tolist() == [-1, -1, -1] * 2
    x = torch.arange(1.0, 25.0)[None]
    assert mirror.observation(x)[0, 6:12].abs().tolist() == [10, 11, 12, 7, 8, 9]


TENDON = """<tendon><fixed stiffness="20"><joint joint="left_hip" coef="1"/>
<joint joint="left_knee" coef="-1"/></fixed></tendon>"""
JOINTS = 'joint1="{0}_hip" joint2="{0}_knee"'
EQUALITY = f'<equality><joint {JOINTS} polycoef="0 {{1}}1 0 0 0"/></equality>'
LEFT, RIGHT = EQUALITY.format("left", "+"), EQUALITY.format("right", "-")


@pytest.mark.parametrize("tolerance", [0.0, 0.05])
def test_bodies_of_designs_with_a_tendon_or_constraint_on_one_side_are_refused(tolerance):
    class Bound(Biped):
        """A biped whose design binds joints of the left leg to each other."""

        designs = {"bond": envs.DesignParameter(0.0, 0.0, 20.0, "N m/rad")}
        episode_length = 20

        @classmethod
        def load_spec(cls) -> mujoco.MjSpec:
            tendon = TENDON.replace('stiffness="20"', 'name="bond"')
            return mujoco.MjSpec.from_string(BIPED.replace("<actuator>", tendon + "<actuator>"))

        @classmethod
        def shape(cls, spec: mujoco.MjSpec, design: dict[str, float]) -> None:
            spec.tendon("bond").stiffness[0] = design["bond"]

    envs.registry._REGISTRY["bound"] = Bound
    changes = {"network.symmetric": True, "network.symmetry_tolerance": tolerance}
    env, config = envs.make("bound", 16, "cpu"), tiny("bound", **changes, **{"sampling.designs": 4})
    env.mirror(tolerance)
    with pytest.raises(MorlaxError, match="accelerate differently, such as by a tendon"):
        DesignDraws(env, config)
    for constraints, refused in ((LEFT, True), (LEFT + RIGHT, False)):
        xml = BIPED.replace("<actuator>", constraints + "<actuator>")
        with pytest.raises(MorlaxError, match="accelerate diff") if refused else nullcontext():
            check(mujoco.MjModel.from_xml_string(xml), tolerance)


def put(tag: str, name: str, **attributes: str) -> Callable[[ElementTree.Element], object]:
    return lambda root: root.find(f".//{tag}[@name='{name}']").attrib.update(attributes)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (
            put("geom", "left_foot", friction="0.95"),
            "geom_friction of left_foot 0.95, of right_foot 1",
        ),
        (put("geom", "left_foot", pos=".001 0 0"), "position of left_foot 0.001"),
        (put("geom", "left_thigh", density="1010"), "mass of left_thigh"),
        (put("joint", "left_hip", range="-20 41"), "jnt_range of left_hip"),
        (put("motor", "left_hip", gear="21"), "actuator_gear of left_hip 21, of right_hip 20"),
        (
            lambda root: root.find("option").set("gravity", "0 .1 -9.8"),
            "gravity points to one side",
        ),
        (lambda root: root.append(ElementTree.fromstring(TENDON)), "accelerate differently"),
        (lambda root: root.append(ElementTree.fromstring(LEFT)), "accelerate differently"),
    ],
)
def test_robots_whose_left_and_right_differ_are_refused_by_name(edit, words):
    with pytest.raises(MorlaxError, match=re.escape(words)):
        mirror_of(edit)


def test_tasks_that_see_or_reward_one_side_more_are_refused():
    def effort(env: Biped) -> dict[str, torch.Tensor]:
        squares = env.physics.ctrl.square()
        return {**Biped.terms(env), "effort": squares.sum(-1) + 0.03 * squares[:, 0]}

    with pytest.raises(MorlaxError, match="other rewards of the objective energy"):
        mirror_of(terms=effort)
    scales = torch.ones(24, dtype=torch.float64)
    scales[8] = 1.03
    with pytest.raises(MorlaxError, match="number 8 of its observation has no mirror image"):
        mirror_of(observe=lambda env: Biped.observe(env) * scales)


def test_a_task_with_a_command_is_refused_also_where_the_command_changes_late():
    def state(env: Biped) -> dict[str, torch.Tensor]:
        return {"command": torch.zeros(env.num_worlds, 1, dtype=torch.float64)}

    def observe(env: Biped) -> torch.Tensor:
        return torch.cat([Biped.observe(env), env.command], -1)

    limits = {"m/s to the left": (-1.0, 1.0)}
    with pytest.raises(MorlaxError, match="it follows a command: set "):
        mirror_of(initial_state=state, observe=observe, command_limits=limits)


def test_a_number_that_stays_zero_until_late_in_an_episode_is_mirrored_as_it_is_then():
    def observe(env: Biped) -> torch.Tensor:
        late = (env.age >= 500)[:, None]
        return torch.cat([Biped.observe(env), env.physics.qvel[:, :2] * late], -1)

    assert mirror_of(observe=observe, Options=Long).observation.sign[-2:].tolist() == [1, -1]


def test_ball_joints_are_refused_by_name():
    ball = '<body name="caster"><joint type="ball"/><geom size=".02" pos="0 0 -.1"/></body>'

    def add(root: ElementTree.Element) -> None:
        root.find(".//body[@name='torso']").append(ElementTree.fromstring(ball))

    with pytest.raises(MorlaxError, match="since it has ball joints"):
        mirror_of(add)


def test_a_robot_that_faces_another_way_is_told_where_left_and_right_are():
    with pytest.raises(MorlaxError, match=r"no mirrored partner .* those of y = 0"):
        mirror_of(put("body", "left_thigh", pos=".2 .08 -.1"))


NETWORKS = {name: task_values(name, "cuda").get("network", {}) for name in envs.names()}
SYMMETRIC = [name for name, network in NETWORKS.items() if network.get("symmetric")]


@pytest.mark.parametrize("task", SYMMETRIC)
def test_shipped_configs_state_how_far_left_and_right_differ(task):
    env, tolerance = envs.make(task, 1, "cpu"), NETWORKS[task].get("symmetry_tolerance", 0.0)
    env.mirror(tolerance)
    with pytest.raises(MorlaxError, match="left and right of this robot differ"):
        env.mirror(0.8 * tolerance)
