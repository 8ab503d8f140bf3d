"""Shapes and their parts: what every stage after `import_shapes` works on."""

from dataclasses import dataclass

from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.structure.base import Structure


@dataclass(frozen=True, eq=False)
class RawPart:
    """One part as its file gives it."""

    part_id: str  # a part of the structure
    label: str  # semantic name, "" if there is none
    mesh: Mesh  # raw frame; may be open, flipped, doubled


@dataclass(frozen=True)
class AlignedPart:
    """The match that `alignment.align` found for one leaf of a shape's program."""

    part_id: str  # the leaf
    node_id: str  # node of the part tree that it was matched to, "" if it was to none
    label: str  # that node's
    objs: tuple[str, ...]  # names of the node's meshes
    leftovers: tuple[str, ...]  # names of further meshes that lie in its cuboid
    iou: float  # of leaf and node, as in `alignment.Boxes.iou`; 0 if there is no node


@dataclass(frozen=True)
class WrittenPiece:
    """A piece of a connected component of a shape: its intersection with half-spaces, around a point."""

    component: int  # the largest is 0
    planes: tuple[tuple[float, float, float, float], ...]  # unit normal n and offset d: it lies where n·x ≤ d; raw
    inside: tuple[float, float, float]  # a point of it, raw


@dataclass(frozen=True)
class WrittenPart:
    """A part as a user keeps it."""

    name: str  # unique in its shape
    label: str  # semantic name, "" if there is none
    pieces: tuple[WrittenPiece, ...]  # whose union it is


@dataclass(frozen=True)
class WrittenParts:
    """The parts of a shape as a file beside its mesh describes them."""

    components: int  # of the shape, so that a mesh that changed is noticed
    parts: tuple[WrittenPart, ...]


@dataclass(frozen=True, eq=False)
class RawShape:
    """One object as its files give it."""

    shape_id: str  # unique in its category
    split: str  # "train" or "val"
    parts: tuple[RawPart, ...]  # in the structure's order
    structure: Structure  # cuboids and relations in it, if any, are raw too
    alignment: tuple[AlignedPart, ...] = ()  # of a program's leaves, in the structure's order
    whole: bool = False  # it came as one file, whose groups or nodes may be anything: parts, materials
    written: WrittenParts | None = None  # parts that were written down; they come before all others


@dataclass(frozen=True)
class Origin:
    """The source of a shape's parts."""

    parts: str  # "given" by its files, "found" in its surface, "written" in a file beside it
    reason: str  # why
    components: int = 0  # connected solids that they were found in; 0 where they were given
    boxes: float = 0.0  # volume of their cuboids over the shape's; 0 where they were given


GIVEN = Origin("given", "parts as the files have them")


@dataclass(frozen=True)
class Repair:
    """The repair of one part by `solid.make_solid`."""

    method: str  # the step of the chain that made it closed: "none" if it was
    faces_before: int  # as read
    faces_after: int  # of the closed mesh
    volume: float  # of the closed mesh, cubic canonical units
    inside: float  # share of the part's axis-aligned box, canonical, that is inside the closed mesh
    dropped: int  # pieces left out: sheets that the rest represents, specks
    plates: int  # sheets that were given a thickness
    lost: float  # share of the area as read that lies outside the closed mesh, more than `coverage.REACH` from it


@dataclass(frozen=True)
class Audit:
    """Whether a shape's sign can be trusted; see `audit.audit`."""

    clear: int  # points at which rays through the faces as read agree on the side
    differ: int  # of these, points that the closed parts' union puts on the other side
    inside: float  # share of the shape's axis-aligned box, canonical, that is inside the union
    outlier: float = 0.0  # robust z-score of the logarithm of `inside` in the category; 0 until all shapes are known


NOT_AUDITED = Audit(clear=0, differ=0, inside=0.0)


@dataclass(frozen=True, eq=False)
class Part:
    """One labelled, closed mesh of a shape."""

    part_id: str  # a part of the structure
    label: str  # semantic name, "" if there is none
    mesh: Mesh  # canonical, closed, oriented outwards
    repair: Repair  # what made it closed


@dataclass(frozen=True, eq=False)
class Shape:
    """One object."""

    shape_id: str  # unique in its category
    split: str  # "train" or "val"
    parts: tuple[Part, ...]  # in the order of structure.parts()
    structure: Structure  # cuboids in it, if any, are canonical
    similarity: Similarity  # raw → canonical
    alignment: tuple[AlignedPart, ...] = ()  # of a program's leaves, in the structure's order
    audit: Audit = NOT_AUDITED  # of its sign
    origin: Origin = GIVEN  # of its parts

    @property
    def status(self) -> str:
        """Return "passed" if every part was closed as it came, "repaired" otherwise."""
        return "passed" if all(part.repair.method == "none" for part in self.parts) else "repaired"
