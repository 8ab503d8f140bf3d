"""Shapes as files or meshes give them: closed parts, whether they can be used, signed distances."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float
from numpy import ndarray

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.exported import FAR
from cagesdf.formats.listing import ShapeSource, find_shape, find_shapes, read_shape
from cagesdf.formats.parts_folder import flat_shape
from cagesdf.geometry.meshes import Mesh
from cagesdf.importing import import_shape, signed_distances, verdict
from cagesdf.shape import RawShape, Shape

# As `make own` imports shapes.
IMPORT: dict[str, Any] = {
    "parts": "auto", "up": "y", "weld": 1e-5, "max_faces": 2_000_000, "max_parts": 150, "min_thickness": 1e-4,
}  # fmt: skip
UNNAMED = "shape"  # id of a shape that came as meshes

# One shape: a mesh file, a folder of part meshes, a PartNet shape; a mesh, or the meshes of its parts by name.
Source = Path | str | trimesh.Trimesh | Mapping[str, trimesh.Trimesh]


@dataclass(frozen=True)
class ShapeCheck:
    """Result of the check of one shape of a folder."""

    shape_id: str
    usable: bool
    verdict: str  # passed; repaired and how; or rejected and why

    def __str__(self) -> str:
        return f"{self.shape_id}: {self.verdict}"


def check(folder: Path | str, include: str = "*") -> list[ShapeCheck]:
    """Whether each shape of a folder passes, how it was repaired, or why it was rejected; sorted by id.

    `folder` may also be a single shape. `include` is a glob over the names of its shapes. Raises InputError if there
    are none.
    """
    return list(checked(find_shapes(Path(folder), include)))


def checked(sources: Iterable[ShapeSource]) -> Iterator[ShapeCheck]:
    """The check of each shape, as it is done."""
    for source in sources:
        try:
            shape = import_shape(read_shape(source), **IMPORT)
            yield ShapeCheck(source.shape_id, True, verdict(shape))
        except ShapeRejected as error:
            yield ShapeCheck(source.shape_id, False, f"rejected: {error.reason}")


def signed_distance(meshes: Source, points: ndarray | Sequence[Sequence[float]]) -> Float[ndarray, " n"]:
    """The signed distance of each point, a row x, y, z, to the surface of all parts together; negative inside.

    Points and distances are in the meshes' own frame and unit. Parts are closed first, as for training. Raises
    InputError for a shape that can't be closed, and for float32 points too far from the origin.
    """
    points = np.asarray(points)
    points = points.astype(np.float64) if points.dtype.kind in "iu" else points
    check_points(points)
    shape = imported(meshes, "given")  # distances don't ask which part a surface is of
    check_points(points, shape)
    return signed_distances(shape, points.astype(np.float64))


def check_points(points: ndarray, shape: Shape | None = None) -> None:
    """Raise InputError unless these are finite rows x, y, z, and exact enough for the place of `shape`."""
    if points.dtype.kind != "f" or points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"got {points.dtype} of shape {points.shape}; wanted floating-point rows x, y, z")
    if not (finite := np.isfinite(points).all(1)).all():
        row = int(finite.argmin())
        raise InputError(f"row {row} is {points[row].tolist()}; wanted finite numbers")
    if shape is None or points.dtype.itemsize >= 8:
        return
    reach = float(np.abs(shape.similarity.to_raw(np.zeros((1, 3)))).max())
    if reach > FAR / shape.similarity.scale:
        raise InputError(
            f"got {points.dtype}, which is {np.spacing(points.dtype.type(reach)):.2g} apart where the shape is, "
            f"{reach:,.0f} from the origin; wanted float64"
        )


def imported(source: Source, parts: str = "auto") -> Shape:
    """The one shape of a source, its parts closed; `parts` as in `import_shape`.

    Raises InputError if there are other shapes, or it can't be used.
    """
    try:
        return import_shape(_raw(source), **IMPORT | {"parts": parts})
    except ShapeRejected as error:
        name = source if isinstance(source, (Path, str)) else error.shape_id
        raise InputError(f"{name}: rejected: {error.reason}") from error


def _raw(source: Source) -> RawShape:
    if isinstance(source, (Path, str)):
        return read_shape(find_shape(Path(source)))
    parts = source if isinstance(source, Mapping) else {UNNAMED: source}
    raw = flat_shape(UNNAMED, "train", [(name, _mesh(part)) for name, part in parts.items()])
    return replace(raw, whole=not isinstance(source, Mapping))


def _mesh(mesh: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int32))
