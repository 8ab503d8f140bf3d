"""Mapping over items in input order, on one process per core, or on a cluster."""

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from tqdm import tqdm

from pipeline.errors import SettingError, WorkerError
from pipeline.processes import DaskProcesses, Died, LocalProcesses, Processes, ThisProcess

Item = TypeVar("Item")
Result = TypeVar("Result")
Rejected = TypeVar("Rejected", bound=Exception)


def workers() -> int:
    """Processes to use: CAGESDF_WORKERS, or one a core. Changes no result."""
    value = os.environ.get("CAGESDF_WORKERS", "")
    if not value:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not value.isdigit() or int(value) < 1:
        raise SettingError(f"CAGESDF_WORKERS: wanted a positive number, got {value!r}")
    return int(value)


def item_seconds() -> float:
    """How long one item may take: CAGESDF_ITEM_SECONDS, or half an hour, hundreds of times what any has taken."""
    value = os.environ.get("CAGESDF_ITEM_SECONDS", "1800")
    if not value.isdigit() or int(value) < 1:
        raise SettingError(f"CAGESDF_ITEM_SECONDS: wanted a positive number, got {value!r}")
    return float(value)


def progress(items: Iterable[Item], total: int, label: str) -> "tqdm[Item]":
    """`items` with a progress bar on standard error; at most two lines a minute where that is no terminal.

    CAGESDF_LANE says which of several that are shown at once this is, below the one that has no number.
    """
    terminal = sys.stderr.isatty()
    return tqdm(
        items,
        total=total,
        desc=label,
        file=sys.stderr,
        mininterval=0.5 if terminal else 30,
        dynamic_ncols=True,
        position=int(os.environ.get("CAGESDF_LANE", -1)) + 1 if terminal else None,
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
    if value == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        kind = torch.device(value).type
    except RuntimeError as error:
        raise SettingError(f"CAGESDF_DEVICE: wanted a device such as cpu or cuda, got {value!r}") from error
    if kind == "cuda" and not torch.cuda.is_available():
        raise SettingError(f"CAGESDF_DEVICE: got {value!r}, but torch finds no GPU here; wanted cpu")
    return value


def parallel_map(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    rejects: type[Rejected],
    label: str,
    lost: Callable[[Item, str], Rejected] | None = None,
) -> tuple[list[Result], list[Rejected]]:
    """`function` of every item, in input order, and the exceptions of type `rejects` it raised.

    Any other exception stops the map. Each item has a process to itself meanwhile, and one thread: one of
    `workers()` processes of this machine, or one of the Dask cluster that CAGESDF_DASK names. An item whose
    process dies (killed for its memory, say) or takes more than `item_seconds()` is called once more, after
    all others and alone; if that fails too, it is rejected as `lost(item, reason)`, or WorkerError names it
    where no `lost` is given. CAGESDF_WORKERS=1 calls all in this process, where nothing guards against that.
    """
    [(_, results, rejected)] = parallel_groups(function, [items], rejects, label, lost)
    return results, rejected


def parallel_groups(
    function: Callable[[Item], Result],
    groups: Sequence[Sequence[Item]],
    rejects: type[Rejected],
    label: str,
    lost: Callable[[Item, str], Rejected] | None = None,
) -> Iterator[tuple[int, list[Result], list[Rejected]]]:
    """`parallel_map` of all groups' items together: yields each group's number and outcome as it is complete.

    Groups begin in their order and no worker waits for the end of one; what was yielded is no longer held.
    """
    call = _Call(function, rejects)
    items = [item for group in groups for item in group]
    owner = [number for number, group in enumerate(groups) for _ in group]
    pending = [len(group) for group in groups]
    outcomes: list[dict[int, Any]] = [{} for _ in groups]
    died: dict[int, Died] = {}

    def ready(item: int, outcome: Any) -> Iterator[tuple[int, list[Result], list[Rejected]]]:
        group = owner[item]
        outcomes[group][item] = outcome
        if len(outcomes[group]) == pending[group]:
            yield (group, *_apart(outcomes[group]))
            outcomes[group].clear()

    yield from ((group, [], []) for group, size in enumerate(pending) if not size)
    processes = _processes(len(items))
    with progress((), total=len(items), label=label) as bar:
        for number, outcome in processes.outcomes(call, items):
            if isinstance(outcome, Died):
                died[number] = outcome
            else:
                bar.update()
                yield from ready(number, outcome)
        for number, end in sorted(died.items()):
            item = items[number]
            tqdm.write(f"{label}: item {number} killed its process, trying again: {end}", sys.stderr)
            [(_, outcome)] = processes.outcomes(call, [item])
            if isinstance(outcome, Died):
                reason = f"killed its process twice: a crash, out of memory, or more than {item_seconds():g} s"
                if lost is None:
                    raise WorkerError(f"{label}: {item!r:.200} {reason}")
                outcome = None, lost(item, reason)
            bar.update()
            yield from ready(number, outcome)


def _apart(outcomes: dict[int, Any]) -> tuple[list[Any], list[Any]]:
    """Results and rejections of `_Call`, each in the order of the items."""
    ordered = [outcomes[number] for number in sorted(outcomes)]
    return [result for result, rejected in ordered if rejected is None], [r for _, r in ordered if r is not None]


def _processes(items: int) -> Processes:
    address, alone = os.environ.get("CAGESDF_DASK"), os.environ.get("CAGESDF_WORKERS") == "1"
    if address and items:
        return DaskProcesses(address, item_seconds())
    return ThisProcess() if alone else LocalProcesses(workers(), item_seconds())


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
