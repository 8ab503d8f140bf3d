"""Several processes: torchrun's own, over the loopback interface."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from cagesdf.models.arms import DECODERS
from cagesdf.training.distributed import ALONE, Ranks, joined_ranks

ROOT = Path(__file__).parents[2]
TRAINING = """
import sys
from dataclasses import replace
from pathlib import Path
import torch
from cagesdf.models.arms import DECODERS
from tests.support.training import SETTINGS, training
from cagesdf.training.distributed import joined_ranks
with joined_ranks() as ranks:
    out = Path(sys.argv[1])
    settings = replace(SETTINGS, steps=int(sys.argv[2]))
    for name in DECODERS:
        state, log, _ = training(out / name, settings, decoder=name, batch=7, ranks=ranks)
        torch.save((state, log), out / f"{name}{ranks.rank}.pt")
"""


def launched(folder: Path, script: str, *arguments: str, ranks: int = 2) -> subprocess.CompletedProcess[str]:
    """A script on so many ranks of this machine."""
    folder.mkdir(exist_ok=True)
    (folder / "script.py").write_text(script, encoding="utf-8")
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={ranks}"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "CAGESDF_DEVICE": "cpu"}
    return subprocess.run(
        [*command, str(folder / "script.py"), *arguments],
        env={**environment, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )


def test_shares_are_runs_that_cover_every_group_once() -> None:
    for size in (1, 2, 3, 5):
        for groups in (0, 1, 4, 7, 16):
            shares = [Ranks(rank, size).share(groups) for rank in range(size)]
            assert [group for share in shares for group in share] == list(range(groups))
            assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_alone_nothing_is_summed_and_nobody_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with joined_ranks() as ranks:
        assert ranks == ALONE
        one = torch.ones(2)
        ranks.all_reduce([one])
        assert torch.equal(one, torch.ones(2))
        assert ranks.broadcast({"a": 1}) == {"a": 1}
        ranks.barrier()


@pytest.mark.slow
def test_two_processes_train_as_one_within_rounding_and_hold_the_same_bits(tmp_path: Path) -> None:
    for name, ranks in (("one", 1), ("two", 2)):
        done = launched(tmp_path / name, TRAINING, str(tmp_path / name), "20", ranks=ranks)
        assert done.returncode == 0, done.stderr
    for decoder in DECODERS:
        files = (f"{where}/{decoder}{rank}.pt" for where, rank in (("one", 0), ("two", 0), ("two", 1)))
        (one, log), *both = (torch.load(tmp_path / name) for name in files)
        for name, tensor in both[0][0].items():
            assert torch.equal(tensor, both[1][0][name]), name
            # Where a cage has one part, attention has no choice: rounding is all of its gradient, which Adam enlarges.
            if ".into." not in name:
                torch.testing.assert_close(tensor, one[name], rtol=1e-3, atol=2e-4)
        assert [row["step"] for row in log] == [row["step"] for row in both[0][1]]
        assert [row["l1"] for row in both[0][1]] == pytest.approx([row["l1"] for row in log], rel=1e-4)


@pytest.mark.slow
def test_an_error_on_one_rank_ends_all(tmp_path: Path) -> None:
    script = """
from cagesdf.training.distributed import joined_ranks
with joined_ranks() as ranks:
    if ranks.rank == 1:
        raise SystemExit("rank 1 found nothing")
    ranks.barrier()
"""
    done = launched(tmp_path, script)
    assert done.returncode != 0
    assert "rank 1 found nothing" in done.stderr
