"""Relations between sibling parts: attachments and the symmetries of StructureNet."""

from dataclasses import dataclass

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Adjacency:
    """Two parts that touch."""

    a: str  # part id
    b: str  # part id
    distance: float  # gap between the parts, canonical units


@dataclass(frozen=True)
class Reflection:
    """Part b is part a mirrored in a plane."""

    a: str  # part id
    b: str  # part id
    point: Vector  # on the plane, canonical
    normal: Vector  # unit, canonical


@dataclass(frozen=True)
class Translation:
    """Part b is part a moved."""

    a: str  # part id
    b: str  # part id
    offset: Vector  # canonical units


@dataclass(frozen=True)
class Rotation:
    """Part b is part a turned about an axis."""

    a: str  # part id
    b: str  # part id
    pivot: Vector  # on the axis, canonical
    axis: Vector  # unit, canonical
    angle: float  # radians


Relation = Adjacency | Reflection | Translation | Rotation
