"""Figures from processes of their own: on one core, with their own peak memory, and free to fail."""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

LIMIT = 900  # seconds
PATIENCE = 20  # seconds


def ask(script: str, *arguments: object) -> dict[str, Any] | str:
    """The JSON object in the last line that a script of this folder prints; or the last line of its error."""
    threads = dict.fromkeys(("IGL_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, "-m", f"benchmarks.{Path(script).stem}", *map(str, arguments)]
    try:
        run = subprocess.run(command, capture_output=True, text=True, env=os.environ | threads, timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return f"not done after {LIMIT} s"
    if run.returncode == 0:
        return dict(json.loads(run.stdout.splitlines()[-1]))
    if run.returncode < 0:
        return f"killed by signal {-run.returncode}"
    return run.stderr.strip().splitlines()[-1]


def to_one_core() -> None:
    """Keep this process on one core, whatever its libraries' threads do."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def seconds(work: Callable[[], object], repetitions: int) -> float:
    """Processor time, so that others on the machine count little: median over repetitions until PATIENCE is over."""
    times: list[float] = []
    while len(times) < repetitions and sum(times) < PATIENCE:
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return median(times)


def peak() -> float:
    """Largest memory that this process has had, MB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def table(header: str, rows: list[str]) -> str:
    """Markdown."""
    return "\n".join([header, "|" + "---|" * (header.count("|") - 1), *rows])
