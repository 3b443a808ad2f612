"""TensorBoard shows what the docs list, and statistics of episodes count whole episodes."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import metadata as layout_metadata
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout
from tensorboard.plugins.hparams import metadata
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData
from tiny import learner, tiny

from morlax_torch import config_for
from morlax_torch.gpu.optimizer import ClippedAdam
from morlax_torch.runs import Run
from morlax_torch.runs.training import make_evaluator
from morlax_torch.train import train

PAGE = Path(__file__).parents[2] / "docs" / "training.md"
LONG = {"max_env_steps": 320, "evaluation.every": 160}
OTHERS = (
    {"ppo.optimizer": "joint", "ppo.critic": "scalar", "target": 1e5},
    {"algorithm": "hyper-sac"},
    {"scalarization": "constrained:run"},
)
PLACEHOLDERS = {"OBJECTIVE": ("run", "jump"), "LEVEL": ("0", "0.25", "0.5", "0.75", "1")}


def events(run: Run) -> EventAccumulator:
    return EventAccumulator(str(run.folder), size_guidance={"tensors": 0}).Reload()


def documented() -> set[str]:
    """Return the tags of the docs' table, with hopper's objectives."""
    section = PAGE.read_text().split("\n## TensorBoard\n")[1].split("\n## ")[0]
    cells = "\n".join(line for line in section.splitlines() if line.startswith("| `"))
    tags = set(re.findall(r"`([a-z]+(?:/[\w/]+)|config|hardware)`", cells))
    for name, values in PLACEHOLDERS.items():
        named = {tag for tag in tags if name in tag}
        tags = tags - named | {tag.replace(name, value) for tag in named for value in values}
    return tags


def written(run: Run) -> list[str]:
    tags = events(run).Tags()
    texts = {*tags["tensors"]} - {layout_metadata.CONFIG_SUMMARY_TAG}
    found = [*tags["scalars"], *tags["images"], *texts]
    return [tag.removesuffix("/text_summary") for tag in found]


def test_the_documented_tags_are_those_written(tmp_path):
    found = set()
    for number, changes in enumerate(({}, *OTHERS)):
        run = train(tiny(**LONG, **changes), output=tmp_path / str(number))
        tags = written(run)
        assert len(tags) == len(set(tags))
        found |= set(tags)
    assert found == documented()
    check_hparams(run)


def check_hparams(run: Run) -> None:
    """TensorBoard's HPARAMS tab has the config and names the indicators."""
    found = events(run)
    summaries = found.SummaryMetadata

    def content(tag: str) -> Any:
        return HParamsPluginData.FromString(summaries(tag).plugin_data.content)

    values = content(metadata.SESSION_START_INFO_TAG).session_start_info.hparams
    assert values["env"].string_value == "hopper"
    assert values["worlds"].number_value == 8
    assert values["ppo.learning_rate"].number_value == run.config().ppo.learning_rate
    assert values["decay_fraction"].number_value == 0.5
    assert values["network.hidden"].string_value == "[4]"
    experiment = content(metadata.EXPERIMENT_TAG).experiment
    names = [info.name for info in experiment.hparam_infos]
    assert set(names) == set(values)
    tags = {info.name.tag for info in experiment.metric_infos}
    assert {"front/hypervolume", "time/train_seconds"} <= tags
    assert tags <= set(found.Tags()["scalars"])


def test_the_hypervolume_comes_first_and_pictures_last(tmp_path):
    run = train(tiny(**LONG, target=1e5), output=tmp_path / "run")
    found = events(run)
    tags = sorted([*found.Tags()["scalars"], *found.Tags()["images"]])  # as TensorBoard does
    assert tags[0] == "front/hypervolume"
    assert tags[-2:] == sorted(found.Tags()["images"])
    layout = Layout.FromString(
        found.Tensors(layout_metadata.CONFIG_SUMMARY_TAG)[0].tensor_proto.string_val[0]
    )
    (chart,) = layout.category[0].chart
    (pattern,) = chart.multiline.tag
    together = [tag for tag in tags if re.match(pattern, tag)]
    kinds = ("", "_estimate", "_target")
    assert together == [f"front/hypervolume{kind}" for kind in kinds]
    assert [point.value for point in found.Scalars(together[2])] == [1e5] * 3
    estimates = [point.value for point in found.Scalars(together[1])]
    assert len(estimates) == 2 and min(estimates) > 0


@pytest.mark.parametrize(
    ("changes", "target"),
    [
        ({}, 6e6),
        ({"task.stagger": True, "task.guide": {"alive": 1.0}, "worlds": 64}, 6e6),
        ({"task.reference_point": (-1.0, -1.0)}, None),
        ({"evaluation.protocol": "discounted"}, None),
        ({"task.episode_length": 100, "target": 3.0}, 3.0),
    ],
)
def test_a_published_target_is_of_the_task_as_published(changes, target):
    assert config_for("hopper", device="cpu", **changes).fitting_target == target


def test_the_hypervolume_is_estimated_from_rewards_and_failures():
    def estimate(*rates: tuple[float, float, float], **changes: Any) -> float:
        made = learner(tiny(**{"task.episode_length": 100, **changes}))
        return make_evaluator(made).estimate(np.array(rates))

    assert estimate((2, 0, 0), (1, 3, 0)) == pytest.approx(100 * 300)  # the first adds nothing
    often = (1 - 0.9**100) / 0.1  # steps until the first failure, or the end
    assert estimate((1, 3, 0.1)) == pytest.approx(3 * often**2)
    assert estimate((-1, 3, 0)) == estimate((math.nan, 3, 0)) == 0
    discounted = {"evaluation.protocol": "discounted"}
    weights = (1 - 0.99**100) / 0.01
    assert estimate((1, 3, 0), **discounted) == pytest.approx((weights + 100) * (3 * weights + 100))


@pytest.mark.parametrize(("guide", "number"), [({}, 2), ({"alive": 5.0}, 0)])
def test_rewards_that_fronts_do_not_count_estimate_no_hypervolume(guide, number, tmp_path):
    seen = []
    config = tiny(**LONG, **{"task.guide": guide})
    train(config, output=tmp_path / "run", on_metrics=lambda scalars, steps: seen.extend(scalars))
    assert seen.count("front/hypervolume_estimate") == number


def test_an_episode_s_return_is_that_of_the_worlds_also_after_a_resume():
    config = tiny(horizon=4)  # episodes last 5 steps, and every fifth rollout ends with one
    made = learner(config)
    rewards, sums = [], torch.zeros(8, 2)
    for iteration in range(5):
        if iteration == 3:
            other = learner(config)
            other.load_state_dict(made.state_dict())
            other._episodes.totals.copy_(made._episodes.totals)
            made = other
        made.iterate()
        rollout = made.rollout
        for t in range(4):
            sums += rollout.reward[t].flatten(0, 1)
            over = (rollout.terminated | rollout.truncated)[t].flatten()
            rewards += sums[over].tolist()
            sums[over] = 0
    totals = made._episodes.totals
    assert len(rewards) == totals[-1] == 32
    torch.testing.assert_close(totals[:2], torch.tensor(rewards).sum(0))
    assert totals[2] / totals[3] == 5


def test_metrics_are_means_over_the_episodes_that_ended():
    rates = {"ppo.learning_rate": 3e-4, "ppo.critic_learning_rate": 7e-4}
    made = learner(tiny(**rates, decay_fraction=0.5), 1)
    found = made.metrics()
    assert "episode_length" not in found  # none has ended
    assert found["learning_rate/actor"] == pytest.approx(3e-4)
    assert found["learning_rate/critic"] == pytest.approx(7e-4)
    assert 0.1 < found["action_std"] < 2
    assert found["gradient_norm/actor"] > 0
    made.iterate(done=0.9)
    found = made.metrics()
    assert found["episode_length"] == 5 and found["episode_return/run"] > 0
    assert "episodes" not in found
    assert 0 < found["learning_rate/actor"] < 3e-4  # decayed
    made.iterate()
    made.iterate()
    assert made.metrics()["episode_length"] == 5


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
@pytest.mark.parametrize("networks", (1, 2))
def test_gradient_norms_are_summed_before_clipping(device, networks):
    parameter = torch.nn.Parameter(torch.zeros(2, 2, device=device))
    adam = ClippedAdam([parameter], 0.1, 0.5, networks)
    slopes = torch.tensor([[3.0, 4.0], [0.0, 12.0]], device=device)
    adam.step((parameter * slopes).sum())
    adam.step((2 * parameter * slopes).sum())
    one = 13.0 if networks == 1 else 2 * (5.0 + 12.0) / 2  # a loss is the mean over networks
    assert adam.norms.item() == pytest.approx(3 * one)
