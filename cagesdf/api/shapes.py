"""Shapes with a surface, in the frame and unit of their files: edited ones, and those that a network was fitted to."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from cagesdf.api.display import PREVIEW, shape_html, write_picture
from cagesdf.cuboid import PROPER_PERMUTATIONS, Cage, Cuboid
from cagesdf.editing.document import Document
from cagesdf.editing.health import Health
from cagesdf.editing.parts import parameters, part_names
from cagesdf.editing.script import (
    Add,
    Axis,
    Blend,
    Build,
    Delete,
    Details,
    Duplicate,
    End,
    Frame,
    Harmonise,
    Mix,
    Move,
    Operation,
    Redo,
    Resize,
    Rotate,
    Scale,
    Script,
    Set,
    Split,
    Style,
    Swap,
    Undo,
    dump,
    parse,
    refusing,
)
from cagesdf.editing.session import Live, Session, as_given
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.exported import ExportedShape
from cagesdf.extraction import LOOSE, Each, Extraction
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh, is_closed, signed_volume
from cagesdf.inference import shapes as inference
from cagesdf.io.exports import check_name, write_export
from cagesdf.io.files import check_folder, replacing
from cagesdf.seeds import item_rng
from cagesdf.structure.base import Structure

RESOLUTION = 128  # cells
LEAST, MOST = 8, 1024  # cells: more would take tens of gigabytes


def check_resolution(resolution: int) -> None:
    """Raise InputError for fewer than LEAST cells and for more than MOST."""
    if not LEAST <= resolution <= MOST:
        wanted = f"wanted {LEAST} to {MOST:,} cells; {RESOLUTION} is usual, 256 is fine"
        raise InputError(f"resolution {resolution:,}: {wanted}")


class ModelledShape(ABC):
    """A shape whose surface a network gives.

    `resolution` is the number of cells along 2.1 times the radius of the shape's bounding sphere. Methods raise
    InputError where the network gives no closed surface.
    """

    @property
    @abstractmethod
    def structure(self) -> Structure:
        """The parts and how they belong together, canonical."""

    @property
    @abstractmethod
    def cage(self) -> Cage:
        """The cuboids by part id, canonical."""

    @property
    @abstractmethod
    def similarity(self) -> Similarity:
        """From the frame of the shape's files to the canonical one."""

    @abstractmethod
    def extract(self, resolution: int = RESOLUTION) -> Extraction:
        """The surface in the canonical frame, and its cost; without faces if the network says outside."""

    @property
    def cuboids(self) -> dict[str, Cuboid]:
        """The cuboids by the parts' names, in the files' frame and unit; lengths along what operations call x, y, z."""
        rotation = self.similarity.rotation
        naming = PROPER_PERMUTATIONS[int(np.einsum("kij,ji->k", PROPER_PERMUTATIONS, rotation).argmax())]
        names, to_files = part_names(self.structure), self.similarity.inverse()
        return {
            names[part]: cuboid.transformed(to_files).permuted(naming) for part, cuboid in self.cage.cuboids().items()
        }

    def exported(self, surface: Extraction) -> ExportedShape:
        """A surface that `extract` gave, its parts and cuboids as files hold them, in the files' frame and unit."""
        exported = as_given(surface.mesh, surface.parts, self.cage, self.structure, self.similarity)
        if not is_closed(exported.surface) or signed_volume(exported.surface) <= 0:
            given = "a surface that isn't closed" if len(exported.surface.faces) else "no surface at all"
            raise InputError(f"the network gives {given}, nothing was written; train longer or raise the resolution")
        return exported

    def mesh(self, resolution: int = RESOLUTION) -> trimesh.Trimesh:
        """The surface: closed, outward, in the files' frame and unit."""
        exported = self.exported(self.extract(resolution))
        return _trimesh(exported.surface, exported)

    def parts(self, resolution: int = RESOLUTION) -> dict[str, trimesh.Trimesh]:
        """The closed mesh of each part by name; the surface is their union. Frame and unit as `mesh`."""
        exported = self.exported(self.extract(resolution))
        return {name: _trimesh(part, exported) for name, part in exported.parts.items()}

    def save(self, path: Path | str, resolution: int = RESOLUTION) -> None:
        """Write the surface into a folder that exists: as .ply or .stl, or with its parts, as .obj or .glb."""
        path = Path(path)
        check_name(path)
        check_folder(path)
        exported = self.exported(self.extract(resolution))
        with replacing(path) as partial:
            write_export(partial, exported)

    def picture(self, path: Path | str, size: int = 600, resolution: int = RESOLUTION) -> None:
        """Write a picture of the surface, `size` pixels square, as .png or .jpg into a folder that exists."""
        write_picture(Path(path), self.extract(resolution).mesh, size)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.title}; {len(self.cage)} cuboids>"

    def _repr_html_(self) -> str:
        return shape_html(self.title, self.cage, self.cuboids, self.extract(PREVIEW).mesh)

    @property
    @abstractmethod
    def title(self) -> str:
        """A line about it."""


def _listed(values: object) -> Any:
    """Several numbers as operations have them; what is not several is left to the operation, which refuses it."""
    return tuple(values) if isinstance(values, Iterable) else values


def _trimesh(mesh: Mesh, exported: ExportedShape) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices + exported.origin, mesh.faces, process=False)


class EditableShape(ModelledShape):
    """A shape of a run while it is edited. Each operation changes the shape and returns it.

    The operations are those of scripts (docs/editing.md): `part` is a part's name, label or id, with * and ? for any
    letters and | for or; axes and lengths are those of the shape's files. They raise InputError for parts, parameters
    and styles that don't exist and for cuboids that can't be; the shape stays as it was then.
    """

    def __init__(self, session: Session, shape_id: str, state: State) -> None:
        self._session = session
        self._document = Document.opened(shape_id, state)
        self._live: dict[tuple[int, str, str, str], Live] = {}

    @property
    def shape_id(self) -> str:
        """The id of the run's shape that it was."""
        return self._document.shape_id

    @property
    def title(self) -> str:
        """The shape's id, and how many operations were done."""
        return f"{self.shape_id}, {len(self._document.script)} operations"

    @property
    def state(self) -> State:
        """All that the surface follows from but the network, canonical."""
        return self._document.state

    @property
    def structure(self) -> Structure:
        """The parts and how they belong together, canonical."""
        return self.state.structure

    @property
    def cage(self) -> Cage:
        """The cuboids by part id, canonical."""
        return self.state.cage

    @property
    def similarity(self) -> Similarity:
        """From the frame of the shape's files to the canonical one."""
        return self.state.similarity

    @property
    def parameters(self) -> dict[str, float]:
        """The numbers of the shape's program by the names that `set` takes; none if it has no program."""
        placed = self.structure.placed_program()
        return {} if placed is None else parameters(placed[0])

    @property
    def script(self) -> str:
        """All operations so far as JSON, which `cagesdf edit` and `edit` take."""
        return dump(self._document.script)

    def extract(
        self,
        resolution: int = RESOLUTION,
        method: str = "sparse",
        loose: str = "keep",
        symmetry: str = "none",
        each: Each = map,
    ) -> Extraction:
        """The surface in the canonical frame; only cuboids that changed since the last one are evaluated.

        `method`, `loose` and `symmetry` are extraction's, by name (docs/extraction.md). With `each` a pool's `map`,
        cuboids are evaluated side by side; the surface is the same.
        """
        check_resolution(resolution)
        choices = resolution, method, loose, symmetry
        if choices not in self._live:
            self._live[choices] = self._session.live(*choices)
        return self._live[choices].surface(self.state, each)

    def warnings(self, resolution: int = RESOLUTION) -> tuple[str, ...]:
        """Sentences about what doesn't hold of the surface, as `cagesdf edit` prints them; none where all does.

        They name parts that fall to pieces or have no surface, surfaces in more pieces than their cuboids, and parts
        that are thinner than two of their cells.
        """
        return Health.of(self.extract(resolution), self.state, resolution).warnings()

    def edit(self, script: str | Script) -> "EditableShape":
        """Do all operations of a script, as JSON or read already, or none if one of them can't be done."""
        operations = parse(script) if isinstance(script, str) else script
        self._session.check_editable()
        self._document = self._document.continued(operations, self._session.styles)
        return self

    def move(
        self,
        part: str,
        by: Iterable[float],
        *,
        frame: Frame = "shape",
        mirror: bool = True,
        repeat: bool = False,
        attach: bool = False,
        details: Details = "stretch",
    ) -> "EditableShape":
        """Move cuboids by x, y, z along the files' axes, or along each cuboid's own with `frame` "cuboid".

        With `mirror`, parts that mirror these do the mirrored thing; with `repeat`, parts that repeat them follow; with
        `attach`, parts that touch them stay in contact. Details of cuboids that change their lengths stretch along, or
        "keep" their size.
        """
        fields = {"by": _listed(by), "frame": frame, "mirror": mirror, "repeat": repeat, "attach": attach}
        return self._do(Move, part=part, **fields, details=details)

    def resize(
        self,
        part: str,
        axis: Axis,
        factor: float,
        *,
        keep: End = "centre",
        frame: Frame = "cuboid",
        mirror: bool = True,
        repeat: bool = False,
        attach: bool = False,
        details: Details = "stretch",
    ) -> "EditableShape":
        """Stretch cuboids along an axis by a factor; `keep` says which end stays. The rest as for `move`."""
        fields = {"axis": axis, "factor": factor, "keep": keep, "frame": frame, "details": details}
        return self._do(Resize, part=part, **fields, mirror=mirror, repeat=repeat, attach=attach)

    def rotate(
        self,
        part: str,
        axis: Axis,
        angle: float,
        *,
        frame: Frame = "cuboid",
        mirror: bool = True,
        repeat: bool = False,
        attach: bool = False,
        details: Details = "stretch",
    ) -> "EditableShape":
        """Turn cuboids by degrees, counter-clockwise seen from the axis's tip. The rest as for `move`."""
        fields = {"axis": axis, "angle": angle, "frame": frame, "details": details}
        return self._do(Rotate, part=part, **fields, mirror=mirror, repeat=repeat, attach=attach)

    def add(
        self, name: str, centre: Iterable[float], lengths: Iterable[float], *, like: str | None = None
    ) -> "EditableShape":
        """Add a cuboid along x, y, z in the style of the part `like`, or of that whose lengths are most alike."""
        return self._do(Add, name=name, centre=_listed(centre), lengths=_listed(lengths), like=like)

    def duplicate(
        self, part: str, by: Iterable[float], *, mirror: bool = True, repeat: bool = False
    ) -> "EditableShape":
        """Repeat cuboids x, y, z away; the copies look as their originals do. `mirror`, `repeat` as for `move`."""
        return self._do(Duplicate, part=part, by=_listed(by), mirror=mirror, repeat=repeat)

    def delete(self, part: str, *, mirror: bool = True, repeat: bool = False) -> "EditableShape":
        """Take cuboids away. `mirror`, `repeat` as for `move`."""
        return self._do(Delete, part=part, mirror=mirror, repeat=repeat)

    def split(
        self, part: str, axis: Axis, at: float = 0.5, *, mirror: bool = True, repeat: bool = False
    ) -> "EditableShape":
        """Cut cuboids in two across an axis, `at` a share of their length. `mirror`, `repeat` as for `move`."""
        return self._do(Split, part=part, axis=axis, at=at, mirror=mirror, repeat=repeat)

    def scale(self, factors: Iterable[float], *, details: Details = "stretch") -> "EditableShape":
        """Stretch the whole cage along x, y and z about the centre of the box that the shape had at first."""
        return self._do(Scale, factors=_listed(factors), details=details)

    def set(self, parameter: str, value: float, *, details: Details = "stretch") -> "EditableShape":
        """Give one of `parameters` another value; what is attached to it, or repeats it, follows."""
        return self._do(Set, parameter=parameter, value=value, details=details)

    def swap(self, style_of: str) -> "EditableShape":
        """Take the style of another shape of the run."""
        return self._do(Swap, style_of=style_of)

    def blend(self, style_of: str, weight: float) -> "EditableShape":
        """Go towards the style of another shape: 0 stays, 1 arrives."""
        return self._do(Blend, style_of=style_of, weight=weight)

    def mix(
        self,
        part: str,
        style_of: str,
        *,
        source: str | None = None,
        weight: float = 1.0,
        mirror: bool = True,
        repeat: bool = True,
        details: Details = "stretch",
    ) -> "EditableShape":
        """Take the style of another shape's corresponding parts, or of those called `source`, in some parts.

        Parts that mirror or repeat these do so, too. Details "keep" the size that they have in the other shape, or
        stretch with the cuboid. Raises InputError for an arm whose parts have no codes.
        """
        fields = {"style_of": style_of, "from": source, "weight": weight, "details": details}
        return self._do(Mix, part=part, **fields, mirror=mirror, repeat=repeat)

    def style(
        self,
        code: Iterable[float],
        *,
        residuals: Mapping[str, Iterable[float]] | None = None,
        parts: Mapping[str, Iterable[float]] | None = None,
    ) -> "EditableShape":
        """Take a style by the numbers of its latent code.

        `residuals` gives, by part (id, name or label), numbers that are added to its own code; `parts` gives other
        latent codes that parts have the style of, and takes what was mixed into all others away.
        """
        added, others = (
            None if given is None else {part: _listed(values) for part, values in given.items()}
            for given in (residuals, parts)
        )
        return self._do(Style, code=_listed(code), residuals=added, parts=others)

    def build(self, structure: str, *, frame: Iterable[float] | None = None) -> "EditableShape":
        """Go on with another structure around cuboids of its own, as JSON; the style stays.

        `frame` is the way from the files' frame to the canonical one: scale, rotation by rows, translation.
        """
        return self._do(Build, structure=structure, frame=None if frame is None else _listed(frame))

    def harmonise(self) -> "EditableShape":
        """Give all parts the codes that the network has for them in the cage as it is now."""
        return self._do(Harmonise)

    def undo(self) -> "EditableShape":
        """Take the last operation back that is not taken back yet."""
        return self._do(Undo)

    def redo(self) -> "EditableShape":
        """Do again what was taken back last."""
        return self._do(Redo)

    def _do(self, kind: type[Operation], **fields: Any) -> "EditableShape":
        self._session.check_editable()
        with refusing():
            operation = kind(**fields)
        self._document = self._document.then(operation, self._session.styles)
        return self


class FittedShape(ModelledShape):
    """A shape that the network was not trained on, with the code that explains it best."""

    def __init__(self, session: Session, fit: inference.Fit) -> None:
        self.fit = fit
        self._session = session

    @property
    def title(self) -> str:
        """The shape's id, and the verdict."""
        return f"{self.fit.prepared.shape.shape_id}: {self.fit.verdict}"

    @property
    def verdict(self) -> inference.Verdict:
        """Whether the network should be trusted with it: `far`, and the `reasons`."""
        return self.fit.verdict

    @property
    def structure(self) -> Structure:
        """The parts as the files have them, around the fitted cuboids; canonical."""
        return self.fit.prepared.shape.structure.with_cuboids(self.cage.cuboids())

    @property
    def cage(self) -> Cage:
        """The cuboids by part id, canonical."""
        return self.fit.prepared.fitted.cage

    @property
    def similarity(self) -> Similarity:
        """From the frame of the shape's files to the canonical one."""
        return self.fit.prepared.shape.similarity

    @property
    def residuals(self) -> dict[str, list[float]]:
        """By part id, the numbers that were found to be added to its code."""
        return dict(zip(self.cage.part_ids, self.fit.inferred.residual.cpu().numpy().tolist(), strict=True))

    def extract(self, resolution: int = RESOLUTION, loose: str = "keep", each: Each = map) -> Extraction:
        """The surface in the canonical frame: each part has its own code. Raises InputError if there is none.

        `loose` and `each` as in `EditableShape.extract`.
        """
        check_resolution(resolution)
        return inference.fitted_surface(self._session.run, self.fit, resolution, LOOSE[loose], each)

    def report(self, surface: Extraction, seed: int = 0) -> dict[str, Any]:
        """Results for JSON: the verdict, and the distance of a surface that `extract` gave from the files'."""
        measured = inference.measure(self.fit, surface.mesh, **inference.MEASURE, rng=item_rng(seed, "measure"))
        return inference.report(self.fit, surface, measured)

    def editable(self) -> EditableShape:
        """The same cuboids to edit, in the very style that was found: `extract` gives the same surface."""
        first = min(self._session.run.sequences)
        shape = EditableShape(self._session, first, self._session.opened(first))
        shape.build(self.structure.to_json(), frame=self.similarity.to_numbers())
        return shape.style(self.fit.inferred.code.cpu().numpy().tolist(), residuals=self.residuals)
