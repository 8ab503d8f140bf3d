"""Drafts of shapes: which cuboids there are, how they are grouped, and what fills each of them.

A draft is written on a floor (y = 0) around the y axis, front +z, in lengths of about a metre
for furniture; `finish` moves it by OFFSET, since real data sets aren't centred either. A cuboid
here has the axes its surface is made in: local x is a plane of symmetry of every surface, so a
cuboid mirrored in its first axis holds the mirrored part.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.geometry.meshes import Mesh
from cagesdf.structure.hierarchy import Node, PartHierarchy
from cagesdf.structure.relations import Adjacency, Reflection, Relation, Rotation, Translation

OFFSET = np.array([0.03, -0.42, 0.02])
TOUCHING = 0.02  # cuboids nearer than this are adjacent


@dataclass(frozen=True)
class Style:
    """The choices and numbers of a shape that its cuboids don't show."""

    kinds: Mapping[str, str]  # named choices: of leg, of edge, ...
    factors: Mapping[str, float]  # named numbers, in raw units where they are lengths


Surface = Callable[[ndarray, Style], Mesh]  # size (3,) and style → mesh that fills [-size/2, size/2]
Symmetry = Callable[[str, str], Relation]


@dataclass(frozen=True, eq=False)
class Draft:
    """A node of a shape that is being drawn."""

    label: str
    cuboid: Cuboid | None  # of a leaf; on the floor, axes as its surface is made
    surface: Surface | None  # of a leaf
    children: tuple["Draft", ...] = ()
    symmetries: tuple[tuple[int, int, Symmetry], ...] = ()  # between children, by position


@dataclass(frozen=True, eq=False)
class Drawing:
    """A finished draft."""

    structure: PartHierarchy  # node ids are preorder positions; cuboids in their surfaces' axes, raw frame
    surfaces: Mapping[str, Surface]  # by part id


def box(x: float, y: float, z: float, width: float, height: float, depth: float) -> Cuboid:
    """An upright cuboid: its centre, and its lengths along x, y and z."""
    return Cuboid(np.array([x, y, z]), np.eye(3), np.array([width, height, depth]))


def strut(bottom: ndarray, top: ndarray, width: float, depth: float, forward: ndarray) -> Cuboid:
    """A cuboid whose y axis runs from `bottom` to `top`, its z axis as near as it can be to `forward`."""
    along = np.asarray(top, float) - np.asarray(bottom, float)
    length = float(np.linalg.norm(along))
    y = along / length
    x = np.cross(y, forward)
    x /= np.linalg.norm(x)
    return Cuboid((np.asarray(bottom) + top) / 2, np.stack([x, y, np.cross(x, y)]), np.array([width, length, depth]))


def bar(left: ndarray, right: ndarray, height: float, depth: float) -> Cuboid:
    """A cuboid whose x axis runs from `left` to `right`, its y axis as upright as it can be."""
    along = np.asarray(right, float) - np.asarray(left, float)
    length = float(np.linalg.norm(along))
    x = along / length
    z = np.cross(x, [0.0, 1.0, 0.0])
    z /= np.linalg.norm(z)
    return Cuboid((np.asarray(left) + right) / 2, np.stack([x, np.cross(z, x), z]), np.array([length, height, depth]))


def one(label: str, cuboid: Cuboid, surface: Surface) -> Draft:
    """A single part; as a group, one without symmetry."""
    return Draft(label, cuboid, surface)


def _reflected(cuboid: Cuboid, axis: int, at: float) -> Cuboid:
    mirror = np.ones(3)
    mirror[axis] = -1
    centre = cuboid.centre * mirror
    centre[axis] += 2 * at
    return Cuboid(centre, cuboid.axes * mirror * np.array([[-1.0], [1.0], [1.0]]), cuboid.size)


def _mirror(axis: int, at: float) -> Symmetry:
    point = OFFSET.copy()
    point[axis] += at
    normal = np.eye(3)[axis]
    return lambda a, b: Reflection(a, b, _triple(point), _triple(normal))


def _triple(values: ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def pair(draft: Draft) -> Draft:
    """A part and its mirror image in the plane x = 0."""
    assert draft.cuboid is not None
    twin = replace(draft, cuboid=_reflected(draft.cuboid, 0, 0.0))
    return Draft("", None, None, (draft, twin), ((0, 1, _mirror(0, 0.0)),))


def four(draft: Draft) -> Draft:
    """A part mirrored in the planes x = 0 and z = 0."""
    front = pair(draft).children
    back = tuple(replace(item, cuboid=_reflected(item.cuboid, 2, 0.0)) for item in front if item.cuboid is not None)
    side, rear = _mirror(0, 0.0), _mirror(2, 0.0)
    return Draft("", None, None, (*front, *back), ((0, 1, side), (2, 3, side), (0, 2, rear), (1, 3, rear)))


def around(draft: Draft, count: int) -> Draft:
    """A part turned about the y axis, evenly."""
    assert draft.cuboid is not None
    angle = 2 * np.pi / count
    children, cuboid = [draft], draft.cuboid
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    for _ in range(count - 1):
        cuboid = Cuboid(turn @ cuboid.centre, cuboid.axes @ turn.T, cuboid.size)
        children.append(replace(draft, cuboid=cuboid))

    def relation(a: str, b: str) -> Relation:
        return Rotation(a, b, _triple(OFFSET), (0.0, 1.0, 0.0), angle)

    return Draft("", None, None, tuple(children), tuple((i, i + 1, relation) for i in range(count - 1)))


def row(draft: Draft, offset: ndarray, count: int) -> Draft:
    """A part repeated by a constant step."""
    assert draft.cuboid is not None
    cuboids = [replace(draft.cuboid, centre=draft.cuboid.centre + i * np.asarray(offset)) for i in range(count)]

    def relation(a: str, b: str) -> Relation:
        return Translation(a, b, _triple(np.asarray(offset, float)))

    children = tuple(replace(draft, cuboid=cuboid) for cuboid in cuboids)
    return Draft("", None, None, children, tuple((i, i + 1, relation) for i in range(count - 1)))


def group(label: str, *members: Draft) -> Draft:
    """A node over parts, groups of parts without a label (`pair`, `row`, ...) and other nodes."""
    children: list[Draft] = []
    symmetries: list[tuple[int, int, Symmetry]] = []
    for item in members:
        start = len(children)
        unnamed = not item.label
        children += item.children if unnamed else [item]
        if unnamed:
            symmetries += [(start + i, start + j, relation) for i, j, relation in item.symmetries]
    return Draft(label, None, None, tuple(children), tuple(symmetries))


def finish(draft: Draft) -> Drawing:
    """Number the nodes in preorder, move the shape off the origin, and note which siblings touch."""
    surfaces: dict[str, Surface] = {}
    number = 0

    def node(item: Draft) -> Node:
        nonlocal number
        node_id = str(number)
        number += 1
        if item.cuboid is not None and item.surface is not None:
            surfaces[node_id] = item.surface
            return Node(node_id, item.label, (), (), replace(item.cuboid, centre=item.cuboid.centre + OFFSET))
        children = tuple(node(child) for child in item.children)
        symmetries = [relation(children[i].node_id, children[j].node_id) for i, j, relation in item.symmetries]
        return Node(node_id, item.label, children, (*symmetries, *_adjacencies(children)), None)

    return Drawing(PartHierarchy(node(draft)), surfaces)


def _adjacencies(children: tuple[Node, ...]) -> list[Adjacency]:
    """Siblings whose cuboids come within TOUCHING, found from a grid of points on each."""
    cages = [Cage.of({leaf.node_id: leaf.cuboid for leaf in child.walk() if leaf.cuboid}) for child in children]
    steps = np.array(np.meshgrid(*[np.linspace(-0.5, 0.5, 5)] * 3)).reshape(3, -1).T
    points = [np.concatenate([cage.from_unit(steps, i) for i in range(len(cage))]) for cage in cages]
    result = []
    for i, a in enumerate(children):
        for j, b in enumerate(children[i + 1 :], i + 1):
            gap = min(cages[j].signed_distance(points[i]).min(), cages[i].signed_distance(points[j]).min())
            if gap < TOUCHING:
                result.append(Adjacency(a.node_id, b.node_id, max(0.0, float(gap))))
    return result
