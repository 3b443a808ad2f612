"""Write into a run's folder what training writes."""

from pathlib import Path

from morlax_torch import Front, Policy, save
from morlax_torch.host.files import write_rows
from morlax_torch.runs.checkpoint import fingerprint
from morlax_torch.runs.progress import COUNTERS, FRONTS


def grow(run: Path) -> None:
    """Let a run keep three fronts, of which the last is that of its best checkpoint."""
    rows, front = [[*COUNTERS, "hypervolume"]], Front.load(run / "front.npz")
    (run / FRONTS).mkdir()
    for number in range(3):
        share = (1 + number) / 3
        rows.append([number, 1000 * number, 10.0 * number, 9000 * share])
        mark = front.fingerprint if number == 2 else str(number)
        smaller = front._replace(returns=share * front.returns, fingerprint=mark)
        smaller.save(run / FRONTS / f"{number}.npz")
    write_rows(run / "metrics.csv", rows)


def train_on(run: Path, policy: Policy) -> None:
    """Write the next best checkpoint with its front, whose returns are larger by one."""
    front, mark = Front.load(run / "front.npz"), fingerprint(policy.agent.state_dict())
    save(policy, run / "checkpoints/best.pt")
    front._replace(returns=front.returns + 1, fingerprint=mark).save(run / "front.npz")
