"""Cost of a run: the stages themselves, run on a few shapes, and their times scaled up."""

import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from pipeline.cost import Cost, Counts
from pipeline.errors import PipelineError
from pipeline.executor import progress, workers
from pipeline.params import check
from pipeline.workspace import ROOT, merged, profile_settings

SHAPES = 2  # of each category that are measured: stages' COST asks for as few
CELLS = 64  # surfaces that are measured have, at most: hardly trained networks are asked nearly everywhere
SHORT = 3.0  # seconds: what takes less is measured again, warm
SHARING = {"parallel_map", "parallel_groups", "workers"}  # what a stage imports that shares its items among workers
UNMEASURED = ("library", "report")


@dataclass(frozen=True)
class Measured:
    """One stage on a few items, by one worker."""

    stage: str
    category: str
    arm: str  # "" for stages without
    seconds: float
    items: int  # that took them, of its COST
    size: int  # bytes of its output
    memory: int  # bytes, the highest that the process held until then


@dataclass(frozen=True)
class Estimate:
    """One stage over all categories and arms."""

    stage: str
    items: int
    unit: str  # of items
    seconds: float  # with all workers
    size: int  # bytes on disk
    memory: int  # bytes, all processes together
    measured: str  # what was measured and how it was scaled


def profile_content(profile: str | None) -> dict[str, Any]:
    """The default parameters, with a profile's differences if one is named."""
    content = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    return merged(content, profile_settings(profile)) if profile else content


def measure(content: dict[str, Any], folder: Path, clock: Callable[[], float] = time.perf_counter) -> list[Measured]:
    """Run every stage but the report on SHAPES shapes of each category in `folder`, one worker, and time it.

    `content` is that of a params.yaml. Shapes, networks and numbers of points are the run's own, resolutions too up to
    CELLS; stages' COST has the rest.
    """
    graph = _graph()
    stages = {name: entry["cmd"] for name, entry in graph.items() if name not in UNMEASURED}
    small = reduced(content)
    path = folder / "params.yaml"
    path.write_text(yaml.safe_dump(small), encoding="utf-8")
    sections, run = check(path), content["run"]
    todo = [
        (stage, command, category, arm)
        for category in run["categories"]
        for stage, command in stages.items()
        if ("matrix" in graph[stage] and not of_arms(graph[stage])) or category == run["categories"][0]
        for arm in _arms(graph[stage], run)
    ]
    with _alone(folder):
        return [
            _measured(stage, command, category, arm, sections, clock)
            for stage, command, category, arm in progress(todo, len(todo), "stages measured")
        ]


def _arms(stage: dict[str, Any], run: dict[str, Any]) -> list[str]:
    """The arms that a stage of dvc.yaml is multiplied by; [""] where it isn't."""
    matrix = stage.get("matrix", {}).get("arm")
    return run[matrix.removeprefix("${run.").removesuffix("}")] if matrix else [""]


def reduced(content: dict[str, Any]) -> dict[str, Any]:
    """The parameters that are measured in place of a run's."""
    stages = [name for name in _graph() if name not in UNMEASURED]
    return merged(content, {name: {**cost_of(name).small, **_coarse(content[name])} for name in stages})


def _coarse(section: dict[str, Any]) -> dict[str, Any]:
    """Changes of a stage's parameters while it is measured: nothing is too few, surfaces are coarse."""
    changes: dict[str, Any] = {"max_rejected": 1.0} if "max_rejected" in section else {}
    return changes | ({"resolution": min(section["resolution"], CELLS)} if "resolution" in section else {})


def of_arms(stage: dict[str, Any]) -> bool:
    """Whether a stage of dvc.yaml has to do with networks, which cost the same in every category."""
    return "arm" in stage.get("matrix", {}) or bool({"run.arms", "run.generators"} & {*stage["params"]})


def cost_of(stage: str) -> Cost:
    """The cost that a stage's file declares. Raises PipelineError if it declares nothing."""
    cost = getattr(_module(stage), "COST", None)
    if not isinstance(cost, Cost):
        raise PipelineError(f"stages/{stage}.py: declares no COST; wanted one of pipeline/cost.py")
    return cost


def _measured(
    stage: str, command: str, category: str, arm: str, sections: dict[str, Any], clock: Callable[[], float]
) -> Measured:
    words = command.replace("${item.category}", category).replace("${item.arm}", arm).split()
    section = words[words.index("--params") + 1] if "--params" in words else stage
    words = words[3 : words.index("--params")] if "--params" in words else words[3:]
    run = _module(stage).main
    # The category's name is the one word that isn't a path.
    arguments = [word if word == category else Path(word) for word in words]
    params, cost = sections[section], cost_of(stage)
    if cost.difference is None:
        seconds, items = _timed(run, arguments, params, clock), cost.items(sections, arm)
        if seconds < SHORT:
            seconds = min(seconds, _timed(run, arguments, params, clock))
    else:
        pair = cost.difference(params)
        first, second = (_timed(run, arguments, each, clock) for each in pair)
        fewer, more = (cost.items({**sections, section: each}, arm) for each in pair)
        seconds, items = max(second - first, 0.0), more - fewer
    out = next(path for path in reversed(arguments) if isinstance(path, Path))
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    return Measured(stage, category, arm, seconds, items, size, _highest())


def shared(stage: str) -> bool:
    """Whether workers share a stage: its items, as its file says, or its arms, which `lanes` runs side by side."""
    return bool(SHARING & vars(_module(stage)).keys()) or "arm" in _graph()[stage].get("matrix", {})


def _module(stage: str) -> ModuleType:
    return import_module(f"stages.{stage}")


@cache
def _graph() -> dict[str, Any]:
    """The stages of dvc.yaml."""
    return yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]


def _timed(run: Callable[..., None], arguments: list[Any], params: Any, clock: Callable[[], float]) -> float:
    begun = clock()
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        run(*arguments, params=params)
    return clock() - begun


def _highest() -> int:
    """The most memory that this process has held, bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """In `folder`, with one worker."""
    before = os.environ.get("CAGESDF_WORKERS")
    os.environ["CAGESDF_WORKERS"] = "1"
    try:
        with chdir(folder):
            yield
    finally:
        if before is None:
            del os.environ["CAGESDF_WORKERS"]
        else:
            os.environ["CAGESDF_WORKERS"] = before


def estimate(measured: list[Measured], sections: dict[str, Any], categories: int, processes: int) -> list[Estimate]:
    """The whole run from what was measured, with `processes` workers."""
    stages = dict.fromkeys(item.stage for item in measured)
    return [
        _estimate([item for item in measured if item.stage == stage], sections, categories, processes)
        for stage in stages
    ]


def _estimate(measured: list[Measured], sections: dict[str, Any], categories: int, processes: int) -> Estimate:
    stage = measured[0].stage
    cost, parallel = cost_of(stage), processes if shared(stage) else 1
    seconds, size, total = 0.0, 0.0, 0
    for item in measured:
        times = categories if of_arms(_graph()[stage]) else 1
        items, finer = cost.items(sections, item.arm), _finer(stage, sections)
        seconds += times * item.seconds * finer * items / item.items
        size += times * item.size * finer * (items / item.items if cost.grows else 1)
        total += times * items
    memory = max(item.memory for item in measured) * parallel + cost.held(sections, int(size / len(measured)))
    took, count = sum(item.seconds for item in measured), sum(item.items for item in measured)
    how = f"{took:.1f} s for {count:,} {cost.unit}" + (f", {parallel} workers" if parallel > 1 else "")
    return Estimate(stage, total, cost.unit, seconds / parallel, int(size), memory, how)


def _finer(stage: str, sections: dict[str, Any]) -> float:
    """How much more an item is than a measured one: surfaces grow with the square of the cells along them."""
    return max(getattr(sections[stage], "resolution", CELLS) / CELLS, 1.0) ** 2


def plan(profile: str | None, folder: Path, clock: Callable[[], float] = time.perf_counter) -> list[str]:
    """Lines of the estimate for the default run or a profile; `folder` is an empty one to measure in."""
    content = profile_content(profile)
    measured = measure(content, folder, clock)
    path = folder / "asked.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    sections = check(path)
    counts, categories = Counts.of(sections), len(content["run"]["categories"])
    rows = estimate(measured, sections, categories, workers())
    return [
        f"An estimate from {sum(item.seconds for item in measured):.0f} s of work on {SHAPES} shapes a category, "
        f"scaled to this run on {workers()} workers; what the machine does beside it counts in.",
        f"{counts.shapes * categories:,} shapes in {categories} categories, {counts.deformed * categories:,} deformed "
        f"training shapes, {counts.points * categories:,} points of whole shapes besides each cuboid's own; "
        "those of parts follow their surfaces",
        "",
        *_table(rows),
        "",
        "Not measured: the report. Surfaces are those of hardly trained networks; trained ones are asked less.",
    ]


def _table(rows: list[Estimate]) -> list[str]:
    cells = [["stage", "items", "time", "disk", "memory", "measured"]]
    for row in rows:
        amounts = duration(row.seconds), data(row.size), data(row.memory)
        cells.append([row.stage, f"{row.items:,} {row.unit}", *amounts, row.measured])
    total = duration(sum(row.seconds for row in rows)), data(sum(row.size for row in rows))
    cells.append(["in all", "", *total, data(max(row.memory for row in rows)), ""])
    widths = [max(map(len, column)) for column in zip(*cells)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in cells]


def duration(seconds: float) -> str:
    """Seconds in words: 42 s, 7 min, 3.2 h, 5.1 days."""
    for limit, unit, name in ((100, 1, "s"), (6000, 60, "min"), (172800, 3600, "h")):
        if seconds < limit:
            return f"{seconds / unit:.{1 if seconds / unit < 10 else 0}f} {name}"
    return f"{seconds / 86400:,.1f} days"


def data(size: float) -> str:
    """Bytes in words: 12 MB, 1.4 GB."""
    return f"{size / 1e6:,.0f} MB" if size < 1e9 else f"{size / 1e9:,.1f} GB"
