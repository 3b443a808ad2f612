"""skrl trains in the package's worlds."""

import pytest

pytest.importorskip("skrl", reason="skrl is not installed")

from skrl.agents.torch.ppo import PPO
from skrl.memories.torch import RandomMemory
from skrl.trainers.torch import SequentialTrainer
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from morlax_torch.adapters.skrl import SkrlEnv

pytestmark = pytest.mark.usefixtures("single_thread")


def train(env: SkrlEnv, steps: int, folder: str) -> None:
    logged = {"directory": folder, "experiment_name": "run"}
    logged |= {"write_interval": 100, "checkpoint_interval": 0}
    cfg = {"rollouts": 50, "mini_batches": 4, "discount_factor": 0.97, "experiment": logged}
    names = ("observation_space", "state_space", "action_space", "device")
    spaces = {name: getattr(env, name) for name in names}
    layers = {"input": "OBSERVATIONS", "layers": [64], "activations": "tanh", "name": "net"}
    policy = gaussian_model(**spaces, network=[layers], output="ACTIONS")
    value = deterministic_model(**spaces, network=[layers], output="ONE")
    agent = PPO(
        models={"policy": policy, "value": value},
        memory=RandomMemory(memory_size=50, num_envs=env.num_envs, device=env.device),
        cfg=cfg,
        **spaces,
    )
    cfg = {"timesteps": steps, "headless": True, "disable_progressbar": True}
    cfg |= {"close_environment_at_exit": False}  # it would log after pytest has closed its output
    SequentialTrainer(env=env, agents=agent, cfg=cfg).train()
    agent.writer.close()  # a thread of its own writes the events


@pytest.mark.slow
def test_skrl_ppo_learns_to_run_and_logs_each_objective(tmp_path):
    env = SkrlEnv("hopper", (1.0, 0.0), 64, "cpu", episode_length=100)
    train(env, 700, str(tmp_path))
    logged = EventAccumulator(str(tmp_path / "run")).Reload()
    tags = {tag.split("/ ")[-1]: tag for tag in logged.Tags()["scalars"]}
    run = [event.value for event in logged.Scalars(tags["run"])]
    assert run[-1] > 2 * run[0]
    assert len(logged.Scalars(tags["jump"])) == len(run)
