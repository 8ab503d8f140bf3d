"""Mapping over items in input order, on as many processes as there are cores."""

import os
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import TypeVar

import joblib
import numpy as np
from joblib.externals.loky.process_executor import TerminatedWorkerError
from tqdm import tqdm

Item = TypeVar("Item")
Result = TypeVar("Result")
Rejected = TypeVar("Rejected", bound=Exception)
RETRIES = 2


def workers() -> int:
    """Processes to use: CAGESDF_WORKERS, or one a core. Changes no result."""
    value = os.environ.get("CAGESDF_WORKERS", "")
    if not value:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not value.isdigit() or int(value) < 1:
        raise ValueError(f"CAGESDF_WORKERS: wanted a positive number, got {value!r}")
    return int(value)


def item_rng(seed: int, *ids: str | int) -> np.random.Generator:
    """A generator for one item, the same whatever the order and the number of workers."""
    return np.random.default_rng([seed, *(zlib.crc32(str(part).encode()) for part in ids)])


def draw(seed: int, ids: Iterable[str], count: int) -> list[str]:
    """At most `count` of `ids`, sorted: the same ones even where some of the others are missing."""
    return sorted(sorted(ids, key=lambda name: (item_rng(seed, "draw", name).random(), name))[:count])


def progress(items: Iterable[Item], total: int, label: str) -> "tqdm[Item]":
    """`items` with a progress bar on standard error; at most two lines a minute where that is no terminal."""
    return tqdm(
        items,
        total=total,
        desc=label,
        file=sys.stderr,
        mininterval=0.5 if sys.stderr.isatty() else 30,
        dynamic_ncols=True,
    )


@contextmanager
def counter(total: int, unit: str, label: str) -> Iterator[Callable[..., None]]:
    """Yield `count(done, **shown)` for a bar as `progress` shows it, in steps of any size.

    Its first call says where the count starts: what was done before doesn't enter the rate.
    """
    bar = progress((), total=total, label=label)
    bar.unit, bar.unit_scale = f" {unit}", True
    started = False

    def count(done: int, **shown: str) -> None:
        nonlocal started
        bar.set_postfix(shown, refresh=False)
        if not started:
            bar.initial = bar.n = done
            started = True
        bar.update(done - bar.n)

    with bar:
        yield count


def device() -> str:
    """Where networks run: CAGESDF_DEVICE, or "cuda" if there is one, or "cpu"."""
    import torch

    value = os.environ.get("CAGESDF_DEVICE") or "auto"
    if value != "auto":
        return value
    return "cuda" if torch.cuda.is_available() else "cpu"


def parallel_map(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    rejects: type[Rejected],
    label: str,
) -> tuple[list[Result], list[Rejected]]:
    """`function` of every item, in input order, and the exceptions of type `rejects` it raised.

    One process a core, one thread each. Any other exception stops the map. A worker that dies
    (killed for its memory, say) is replaced and what it left undone is done again, RETRIES
    times; then RuntimeError. With joblib's dask backend the same call runs on more machines.
    """
    call = _Call(function, rejects)
    outcomes: list[tuple[Result | None, Exception | None]] = []
    count = min(workers(), max(len(items), 1))
    bar = progress((), total=len(items), label=label)
    # libigl reads its own variable; loky sets those of OpenMP and the BLAS libraries.
    os.environ["IGL_NUM_THREADS"] = "1"
    for attempt in range(RETRIES + 1):
        try:
            with joblib.parallel_config(backend="loky", inner_max_num_threads=1) if count > 1 else nullcontext():
                pool = joblib.Parallel(n_jobs=count, return_as="generator", batch_size=1)
                for outcome in pool(joblib.delayed(call)(item) for item in items[len(outcomes) :]):
                    outcomes.append(outcome)
                    bar.update()
            break
        except TerminatedWorkerError as error:
            if attempt == RETRIES:
                raise RuntimeError(
                    f"{label}: a worker died {RETRIES + 1} times, last near item {len(outcomes)} of {len(items)}; "
                    "is there enough memory? CAGESDF_WORKERS=1 needs the least"
                ) from error
    bar.close()
    results = [result for result, rejected in outcomes if rejected is None]
    return results, [rejected for _, rejected in outcomes if rejected is not None]  # type: ignore[return-value, misc]


class _Call:
    """Turns the one expected exception into a value, so that it doesn't stop the other workers."""

    def __init__(self, function: Callable, rejects: type[Exception]) -> None:
        self.function = function
        self.rejects = rejects

    def __call__(self, item: object) -> tuple[object, Exception | None]:
        try:
            return self.function(item), None
        except self.rejects as rejected:
            return None, rejected
