"""Two processes that train a family by ParetoPPO; run by test_pareto_ppo.py."""

import os

import torch
from points import Points
from test_pareto_ppo import settings

from morlax_torch.rsl_rl import ParetoPPO


def main(file: str) -> None:
    rank = int(os.environ["RANK"])
    torch.distributed.init_process_group("gloo")
    torch.manual_seed(rank)
    env = Points(24)
    cfg = settings(tradeoffs=4, evaluation_worlds=0, warmup=1, class_name=ParetoPPO)
    cfg |= {"multi_gpu": {"global_rank": rank, "local_rank": rank, "world_size": 2}}
    obs = env.get_observations()
    learner = ParetoPPO.construct_algorithm(obs, env, cfg | {"num_steps_per_env": 4}, "cpu")
    learner.broadcast_parameters()
    for _ in range(2):
        with torch.inference_mode():
            for _ in range(4):
                obs, rewards, dones, extras = env.step(learner.act(obs))
                learner.process_env_step(obs, rewards, dones, extras)
            tradeoffs = learner.actor.tradeoffs.clone()
            learner.compute_returns(obs)
        learner.update()
    parameters = [*learner.actor.parameters(), *learner.critic.parameters()]
    flat = torch.cat([values.detach().flatten() for values in parameters])
    torch.save((flat, tradeoffs), f"{file}{rank}.pt")
