"""What a run will cost: the stages themselves, run on a few shapes, and their times scaled up."""

import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from pipeline.executor import progress, workers
from pipeline.memory import memory as data_limit
from pipeline.params import check
from pipeline.workspace import ROOT, merged, profile_settings

SHAPES = 2  # of each category that are measured
CHUNKS = 16  # a training step that is measured has, at most
WORK = 2e11  # multiplications that a measured training makes, about: a second or some
CELLS = 64  # surfaces that are measured have, at most: hardly trained networks are asked nearly everywhere
SHORT = 3.0  # seconds: what takes less is measured again, warm
SHARING = {"parallel_map", "parallel_groups", "workers"}  # what a stage imports that shares its items among workers
SMALL: dict[str, Any] = {
    "synthesize": {"train": SHAPES, "val": 0},
    "match_targets": {"unmatched": "scale"},
    "sample_points": {"shards": 1},
    "extract_meshes": {"sources": 1, "held_out": 1},
    "make_trials": {"swaps": 0},  # so few shapes may have none
    "train": {"snapshots": []},
    "train_programs": {"steps": 200, "samples": 10},
    "generate": {"shapes": SHAPES},
    "make_clouds": {"drawn": 8},
    "train_features": {"train": 9, "val": 9, "steps": 20},
}
# A network costs the same in every category: these are measured in the first one only.
ONCE = {"train", "extract_meshes", "evaluate", "evaluate_edits", "evaluate_progress", "generate", "evaluate_generation"}
TOGETHER = {"train_features"}  # of all categories
CUT = ("extract_meshes", "generate")  # whose surfaces are measured with CELLS cells at most
DRAWN = ("surfaces", "trials", "new shapes")  # units that aren't one a shape
REJECTING = ("import_shapes", "fit_cuboids", "match_targets", "deform_sequences", "sample_points", "train_programs")
WEIGHTS = ("train", "train_programs")  # whose outputs are as large after many steps as after few


@dataclass(frozen=True)
class Measured:
    """One stage on a few items, by one worker."""

    stage: str
    category: str
    arm: str  # "" for stages without
    seconds: float
    items: int  # that took them; of what: `Counts`
    size: int  # bytes of its output
    memory: int  # bytes, the highest that the process held until then


@dataclass(frozen=True)
class Counts:
    """How much there is to do in one category; exact but for `points`, which each cuboid's minimum adds to.

    How many points parts have follows from their surfaces: they are not counted here, but in what is measured.
    """

    shapes: int  # training and validation
    sequences: int  # training shapes
    deformed: int  # training steps of all sequences
    points: int  # asked for: near the surface and in the cube, of all deformed shapes
    surfaces: int  # to extract where held-out steps have a latent, and the references
    trials: int  # edits

    @staticmethod
    def of(sections: dict[str, Any]) -> "Counts":
        """What the parameters of a run ask for."""
        drawn, deform, sample, extract, trials = (
            sections[name]
            for name in ("synthesize", "deform_sequences", "sample_points", "extract_meshes", "make_trials")
        )
        held_out = len(set(deform.held_out))
        deformed = drawn.train * (deform.steps - held_out)
        return Counts(
            drawn.train + drawn.val,
            drawn.train,
            deformed,
            deformed * (sample.near + sample.uniform),
            min(extract.sources, drawn.train) + min(extract.held_out, drawn.train) * held_out,
            2 * trials.swaps + min(trials.shapes, drawn.train) * (2 + trials.local + len(trials.beyond)),
        )


@dataclass(frozen=True)
class Groups:
    """What `train` makes of points."""

    chunk: int  # points a group
    point: int  # bytes that a point takes where all are in memory


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

    `content` is that of a params.yaml. Shapes, networks and numbers of points are the run's own,
    resolutions too up to CELLS; trainings take `training_steps` of at most CHUNKS groups.
    """
    small = merged(
        merged(content, SMALL), {name: {"resolution": min(content[name]["resolution"], CELLS)} for name in CUT}
    )
    for name in REJECTING:
        small = merged(small, {name: {"max_rejected": 1.0}})
    graph = _graph()
    path = folder / "params.yaml"
    path.write_text(yaml.safe_dump(small), encoding="utf-8")
    sections, run = check(path), content["run"]
    stages = {name: entry["cmd"] for name, entry in graph.items() if name not in ("library", "report")}
    todo = [
        (stage, command, category, arm)
        for category in run["categories"]
        for stage, command in stages.items()
        if stage not in ONCE | TOGETHER or category == run["categories"][0]
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


def _methods(arm: Any) -> int:
    """How many ways an arm has to draw codes."""
    return 1 if arm.decoder == "DeepSdfDecoder" else 2


def training_steps(params: Any) -> int:
    """How many steps of a training are measured, by the size of its network."""
    a_step = min(params.batch_chunks, CHUNKS) * 64 * 6 * params.layers * params.width**2
    return int(min(max(WORK / a_step, 8), 400))


def _measured(
    stage: str, command: str, category: str, arm: str, sections: dict[str, Any], clock: Callable[[], float]
) -> Measured:
    words = command.replace("${item.category}", category).replace("${item.arm}", arm).split()
    section = words[words.index("--params") + 1] if "--params" in words else stage
    words = words[3 : words.index("--params")] if "--params" in words else words[3:]
    run = _module(stage).main
    # The category's name is the one word that isn't a path.
    arguments = [word if word == category else Path(word) for word in words]
    params, items = sections[section], 1
    if stage == "train":
        chunks = min(params.batch_chunks, CHUNKS)
        steps = training_steps(params)
        items = steps * chunks
        # What else the stage does drops out of the difference.
        runs = [params.model_copy(update={"steps": count, "batch_chunks": chunks}) for count in (1, 1 + steps)]
        first, second = (_timed(run, arguments, some, clock) for some in runs)
        seconds = max(second - first, 0.0)
    else:
        seconds = _timed(run, arguments, params, clock)
        if seconds < SHORT:
            seconds = min(seconds, _timed(run, arguments, params, clock))
        counts = Counts.of(sections)
        items = {"surfaces": counts.surfaces, "trials": counts.trials}.get(_unit(stage), SHAPES)
        if stage == "extract_meshes" and sections[f"arms.{arm}"].latents == "deformed":
            items = min(sections["extract_meshes"].sources, SHAPES)
        if stage == "generate":
            items = SHAPES * _methods(sections[f"arms.{arm}"])
    out = next(path for path in reversed(arguments) if isinstance(path, Path))
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    return Measured(stage, category, arm, seconds, items, size, _highest())


def shared(stage: str) -> bool:
    """Whether workers share a stage: its items, as its file says, or its arms, which `lanes` runs side by side."""
    return bool(SHARING & vars(_module(stage)).keys()) or "arm" in _graph()[stage].get("matrix", {})


def _module(stage: str) -> ModuleType:
    return import_module(f"stages.{stage}")


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


def _unit(stage: str) -> str:
    units = {"deform_sequences": "sequences", "match_targets": "sequences", "sample_points": "deformed shapes"}
    surfaces = dict.fromkeys(("extract_meshes", "evaluate"), "surfaces")
    trials = dict.fromkeys(("make_trials", "evaluate_edits"), "trials")
    steps = dict.fromkeys(("train_programs", "train_features"), "steps")
    new = {"generate": "new shapes", "evaluate_generation": "references"}
    return {**units, **surfaces, **trials, **steps, **new, "train": "points"}.get(stage, "shapes")


def estimate(
    found: list[Measured], sections: dict[str, Any], categories: int, groups: Groups, processes: int
) -> list[Estimate]:
    """The whole run from what was measured, with `processes` workers."""
    stages = dict.fromkeys(item.stage for item in found)
    return [
        _estimate([item for item in found if item.stage == stage], sections, categories, groups, processes)
        for stage in stages
    ]


def _estimate(
    some: list[Measured], sections: dict[str, Any], categories: int, groups: Groups, processes: int
) -> Estimate:
    stage, counts = some[0].stage, Counts.of(sections)
    parallel = processes if shared(stage) else 1
    seconds, size, total = 0.0, 0.0, 0
    for item in some:
        times = categories if item.stage in ONCE else 1
        items, done = _amounts(item, sections, counts, groups)
        finer = _finer(stage, sections)
        seconds += times * item.seconds * finer * items / done
        size += times * item.size * finer * (1 if stage in WEIGHTS else items / done)
        total += times * items
    memory = max(item.memory for item in some) * parallel
    if stage == "sample_points":
        memory += int(size / len(some) / sections[stage].shards)  # a shard is mixed in memory
    if stage == "train" and (held := counts.points * groups.point) <= data_limit():
        memory += held
    took, many = sum(item.seconds for item in some), sum(item.items for item in some)
    what = "groups of points" if stage == "train" else _unit(stage) if _unit(stage) in DRAWN else "shapes"
    how = f"{took:.1f} s for {many:,} {what}; per {_unit(stage).removesuffix('s')}"
    how += f", {parallel} workers" if parallel > 1 else ""
    return Estimate(stage, total, _unit(stage), seconds / parallel, int(size), memory, how)


def _finer(stage: str, sections: dict[str, Any]) -> float:
    """How much more an item is than a measured one: surfaces grow with the square of the cells along them."""
    return max(sections[stage].resolution / CELLS, 1.0) ** 2 if stage in CUT else 1.0


def _amounts(item: Measured, sections: dict[str, Any], counts: Counts, groups: Groups) -> tuple[int, int]:
    """How many of a stage's units there are in one category, and how many were measured."""
    unit = _unit(item.stage)
    if item.stage == "train":
        arm = sections[f"arms.{item.arm}"]
        return arm.steps * arm.batch_chunks * groups.chunk, item.items * groups.chunk
    if item.stage == "train_programs":
        return sections[item.stage].steps, SMALL[item.stage]["steps"]
    if item.stage == "generate":
        return sections[item.stage].shapes * _methods(sections[f"arms.{item.arm}"]), item.items
    if item.stage == "evaluate_progress":
        shapes = min(sections[item.stage].shapes, counts.sequences)
        return shapes * (1 + len(sections["train"].snapshots)), min(shapes, SHAPES)
    if item.stage == "train_features":
        return sections[item.stage].steps, SMALL[item.stage]["steps"]
    if item.stage in ("make_clouds", "evaluate_generation"):  # training shapes are compared with as well
        drawn = sections["make_clouds"].drawn
        return counts.shapes + drawn, SHAPES + SMALL["make_clouds"]["drawn"]
    if item.stage == "sample_points":
        return counts.deformed, item.items * counts.deformed // counts.sequences
    if unit == "surfaces" and item.arm and sections[f"arms.{item.arm}"].latents == "deformed":
        return min(sections["extract_meshes"].sources, counts.sequences), item.items
    total = {
        "shapes": counts.shapes,
        "sequences": counts.sequences,
        "surfaces": counts.surfaces,
        "trials": counts.trials,
    }
    return total[unit], item.items


def plan(
    profile: str | None, folder: Path, groups: Groups, clock: Callable[[], float] = time.perf_counter
) -> list[str]:
    """Lines of the estimate for the default run or a profile; `folder` is an empty one to measure in."""
    content = profile_content(profile)
    found = measure(content, folder, clock)
    path = folder / "asked.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    sections = check(path)
    counts, categories = Counts.of(sections), len(content["run"]["categories"])
    rows = estimate(found, sections, categories, groups, workers())
    return [
        f"An estimate from {sum(item.seconds for item in found):.0f} s of work on {SHAPES} shapes a category, "
        f"scaled to this run on {workers()} workers; what the machine does beside it counts in.",
        f"{counts.shapes * categories:,} shapes in {categories} categories, {counts.deformed * categories:,} deformed "
        f"shapes to train on, {counts.points * categories:,} points of whole shapes besides each cuboid's own; "
        "those of parts follow their surfaces",
        "",
        *_table(rows),
        "",
        "Not measured: the report. Surfaces are those of hardly trained networks; trained ones are asked less.",
    ]


def _table(rows: list[Estimate]) -> list[str]:
    cells = [["stage", "items", "time", "disk", "memory", "measured, scaled per"]]
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
