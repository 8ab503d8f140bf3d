"""Whether a surface holds: closed, in one piece where its cuboids are, no part thinner than its cells can show."""

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.sparse.csgraph import connected_components

from cagesdf.deformation.matching import touching
from cagesdf.editing.parts import part_names
from cagesdf.editing.state import State
from cagesdf.extraction import CUBE, USUAL, Fineness
from cagesdf.extraction.promises import count_pieces
from cagesdf.extraction.thinness import HELD, Thickness
from cagesdf.frames import HALF_EXTENT
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.geometry.solid import thickness

FINEST = 512  # cells: no finer resolution is recommended
STEP = 16  # cells, between recommended resolutions
LISTED = 4  # names in one sentence, at most


@runtime_checkable
class Surface(Protocol):
    """A surface of closed parts, such as an `Extraction` or a `GeneratedShape`."""

    @property
    def mesh(self) -> Mesh:
        """The union of the parts, canonical."""

    @property
    def parts(self) -> Mapping[str, Mesh]:
        """The closed mesh of each part, by id; without faces where it has no surface."""

    @property
    def components(self) -> int:
        """Connected components of the mesh."""


@dataclass(frozen=True)
class Health:
    """Topology and thinnest part of a surface, and the resolution that would hold that part."""

    closed: bool
    components: int  # of the surface
    expected: int  # groups of cuboids that touch
    apart: tuple[str, ...]  # names of parts whose cuboids hang together with fewer others than the most do
    torn: tuple[str, ...]  # names of parts that fall to pieces, or have no surface
    thinnest: str | None  # name of the part with the fewest cells through its thickness; None: nothing has a surface
    thickness: float  # of that part: twice its volume over its area, the user's unit; 0 without one
    cells: float  # through that thickness; 0 without one
    resolution: int  # the least, in steps of STEP, with which it has HELD; 0: none up to FINEST

    @staticmethod
    def of(surface: Surface, state: State, resolution: int, fineness: Fineness = USUAL) -> "Health":
        """The health of a state's surface that was made with these cells."""
        names = part_names(state.structure)
        cuboids = {**CUBE.cuboids(), **state.cage.cuboids()}  # a decoder that knows no cuboids has one part, the cube
        torn = [part for part, mesh in surface.parts.items() if not len(mesh.faces) or count_pieces(mesh) > 1]
        made = {part: Thickness(mesh, cuboids[part]) for part, mesh in surface.parts.items() if len(mesh.faces)}

        def through(part: str, count: int) -> float:
            return made[part].cells(made[part].holding_lattice(2 * HALF_EXTENT / count, fineness))

        cells = {part: through(part, resolution) for part in made}
        expected, group = connected_components(touching(state.cage), directed=False)
        alone = group != np.bincount(group).argmax() if expected > 1 else np.zeros(len(group), bool)
        apart = tuple(names.get(part, part) for part, is_alone in zip(state.cage.part_ids, alone) if is_alone)
        closed = bool(len(surface.mesh.faces)) and is_closed(surface.mesh)
        called = tuple(names.get(part, part) for part in torn)
        if not cells:
            return Health(closed, surface.components, int(expected), apart, called, None, 0.0, 0.0, 0)
        part = min(cells, key=lambda part: cells[part])
        finer = range(STEP, FINEST + 1, STEP)
        first = bisect_left(finer, HELD, key=lambda count: through(part, count))
        enough = finer[first] if first < len(finer) else 0
        thick = thickness(surface.parts[part]) / state.similarity.scale
        return Health(
            closed, surface.components, int(expected), apart, called, names.get(part, part), thick, cells[part], enough
        )

    def __str__(self) -> str:
        pieces = f"{self.components} component{'s' * (self.components != 1)}"
        closed = "closed" if self.closed else "not closed" if self.components else "no surface"
        thin = f", thinnest {self.thinnest}: {self._extent}" if self.thinnest else ""
        return f"{closed}, {pieces}{thin}"

    @property
    def _extent(self) -> str:
        return f"{self.thickness:.3g} file units, {self.cells:.1f} cells"

    def warnings(self) -> tuple[str, ...]:
        """Sentences about what doesn't hold; none for a surface that does."""
        sentences = []
        if self.torn:
            sentences.append(
                f"{_listed(self.torn)}: in pieces, or without a surface; another style or thicker cuboids help"
            )
        if self.apart:
            sentences.append(f"{_listed(self.apart)}: not attached to the rest")
        if self.components > self.expected:
            sentences.append(f"the surface is in {self.components} pieces where its cuboids are in {self.expected}")
        if self.thinnest and self.cells < HELD:
            cure = (
                f"{self.resolution} cells would hold it"
                if self.resolution
                else f"more than {FINEST} cells would be needed; make it thicker"
            )
            sentences.append(f"{self.thinnest} is {self._extent} thick; wanted {HELD:g} cells: {cure}")
        return tuple(sentences)


def _listed(names: tuple[str, ...]) -> str:
    """Names in a sentence, or some of many."""
    more = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {more} more" if more > 0 else "")
