"""The command that looks into artefacts."""

import json
import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from cagesdf.cli.telling import working
from cagesdf.errors import InputError
from cagesdf.io.files import check_folder, replacing

MANIFEST = "manifest.json"


def inspect(path: Path, /, *, shape: str | None = None, picture: Path | None = None) -> None:
    """Say what an artefact holds: manifest, schema, counts, ranges and a few rows.

    Parameters
    ----------
    path
        A folder that a stage wrote, one of its .parquet files, or a .ply mesh.
    shape
        The id of a run's shape, whose parts and program's parameters are listed by the names that scripts call them.
    picture
        A .png file for a slice through a shape's distances; for a shard of points or a folder of them.
    """
    with working(f"reading {path}"):
        paragraphs = _described(path) if shape is None else _editable(path, shape)
    print("\n\n".join(paragraphs))
    if picture is not None:
        _draw(path, picture)


def _described(path: Path) -> list[str]:
    """Paragraphs about a folder or file."""
    from cagesdf.io.summary import summarise

    if path.is_dir():
        return _artefact(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file or folder; wanted an artefact such as data/points/chair")
    if path.suffix == ".parquet":
        return [summarise([path])]
    if path.suffix == ".ply":
        return [_mesh(path)]
    raise InputError(f"{path}: wanted an artefact's folder, a .parquet or a .ply file")


def _editable(run: Path, shape_id: str) -> list[str]:
    """Paragraphs about what can be edited: parts, in the user's frame and unit, and parameters."""
    from cagesdf.api.runs import load_run
    from cagesdf.editing.links import mirrors
    from cagesdf.editing.parts import part_names
    from cagesdf.io.summary import aligned, indented

    shape = load_run(run).open(shape_id)
    names, planes = part_names(shape.structure), mirrors(shape.state)
    size = 1 / shape.similarity.scale
    rows = [["part", "id", "centre", "lengths", "mirrored by"]]
    for part, (name, cuboid) in zip(shape.cage.part_ids, shape.cuboids.items(), strict=True):
        partners = ", ".join(names[other] for other in planes[part])
        rows.append([name, part, _places(cuboid.centre, size), _triple(cuboid.size), partners])
    paragraphs = [f"{shape_id}, x, y, z in its file's frame and unit\n{indented(aligned(rows))}"]
    if shape.parameters:
        numbers = [[name, f"{value:.6g}"] for name, value in shape.parameters.items()]
        paragraphs.append(f"parameters of its program\n{indented(aligned(numbers))}")
    return paragraphs


def _triple(numbers: Iterable[float]) -> str:
    return " ".join(f"{number:.4g}" for number in numbers)


def _places(numbers: Iterable[float], size: float) -> str:
    """Positions of something of a size, to 1e-4 of it, however far from the origin it is."""
    decimals = max(0, 4 - math.floor(math.log10(size)))
    return " ".join(f"{number:.{decimals}f}" if abs(number) > 64 * size else f"{number:.4g}" for number in numbers)


def _draw(path: Path, picture: Path) -> None:
    """A slice through the distances of the first shape in a shard."""
    from cagesdf.io.points import shard_paths
    from cagesdf.io.slices import draw_slice, middle_slice

    if picture.suffix.lower() != ".png":
        raise InputError(f"{picture}: wanted a name that ends in .png")
    check_folder(picture)
    middle = middle_slice(shard_paths(path, "shape")[0] if path.is_dir() else path)
    with replacing(picture) as partial:
        draw_slice(middle, partial)


def _artefact(folder: Path) -> list[str]:
    """Paragraphs about a folder that a stage wrote: its manifest, then each of its tables."""
    from cagesdf.io.summary import aligned, indented, summarise

    inside = sorted(item.name for item in folder.iterdir() if (item / MANIFEST).is_file())
    if inside and not (folder / MANIFEST).is_file():
        raise InputError(f"{folder}: holds the artefacts {', '.join(inside)}; inspect one of them")
    manifest = _manifest(folder)
    files: dict[str, dict[str, Any]] = manifest["files"]
    size = sum(item["bytes"] for item in files.values())
    facts = [
        ["kind", f"{manifest['kind']}, format {manifest['format']}"],
        ["files", f"{len(files):,}, {size / 1e6:,.1f} MB"],
        ["inputs", ", ".join(f"{name} {digest[:8]}" for name, digest in manifest.get("inputs", {}).items()) or "none"],
        *([name, json.dumps(value)] for name, value in manifest.get("params", {}).items()),
    ]
    by_ending = Counter(Path(name).suffix for name in files)
    others = [
        [name, f"{item['bytes']:,} bytes"]
        for name, item in files.items()
        if not name.endswith(".parquet") and by_ending[Path(name).suffix] <= 8
    ]
    paragraphs = [f"{folder}\n{indented(aligned([*facts, *others]))}"]
    tables = [folder / name for name in files if name.endswith(".parquet")]
    # Shards are one table in several files.
    stems = sorted({table.stem.rstrip("0123456789") for table in tables})
    shards = [[table for table in tables if table.stem.rstrip("0123456789") == stem] for stem in stems]
    return paragraphs + [summarise(paths) for paths in shards]


def _manifest(folder: Path) -> dict[str, Any]:
    """The manifest that `pipeline.artefact` writes. Raises InputError if it is missing or damaged."""
    from cagesdf.io.weights import read_description

    if not (folder / MANIFEST).is_file():
        raise InputError(f"{folder}: has no {MANIFEST}, so no stage finished it; wanted a folder that a stage wrote")
    manifest = read_description(folder / MANIFEST)
    if not {"kind", "format", "files"} <= manifest.keys():
        raise InputError(f"{folder / MANIFEST}: lacks kind, format or files; rerun the stage that writes it")
    return manifest


def _mesh(path: Path) -> str:
    """What can be said of one mesh."""
    from cagesdf.geometry.meshes import is_closed, signed_volume

    """Counts, bounds and closedness of a mesh."""
    from cagesdf.io.meshes import read_ply
    from cagesdf.io.summary import aligned, indented

    mesh = read_ply(path)
    if len(mesh.faces) == 0:
        return f"{path}: no faces"
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    facts = [["vertices", f"{len(mesh.vertices):,}"], ["faces", f"{len(mesh.faces):,}"]]
    if is_closed(mesh):
        facts += [["closed", "yes: no hole, one orientation"], ["volume", f"{signed_volume(mesh):.4g}"]]
    else:
        facts += [["closed", "no"]]
    side = float((high - low).max()) or 1.0
    facts += [[axis, f"{_places([a], side)} to {_places([b], side)}"] for axis, a, b in zip("xyz", low, high)]
    return f"{path}\n{indented(aligned(facts))}"
