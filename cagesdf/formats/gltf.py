"""glTF 2.0, binary (.glb) or JSON (.gltf): a part for each node of the default scene that has a mesh.

Names, triangles and places are read, nothing else: all primitives of a node's mesh are one part, whatever their
materials. docs/formats.md lists what is read and what is refused. Files are untrusted: the JSON is checked by a schema,
all counts before anything of their size is allocated, and buffers are read only from the file's own folder.

Source: Khronos, glTF 2.0 specification (ISO/IEC 12113:2022).
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.formats.gltf_json import FAN, FOREIGN, MAX_ENTRIES, STRIP, TRIANGLES, GltfJson, Primitive, foreign, load
from cagesdf.formats.gltf_numbers import Numbers
from cagesdf.formats.naming import distinct_names
from cagesdf.formats.polygons import MAX_COORDINATE
from cagesdf.geometry.meshes import Mesh, join

SUFFIXES = (".glb", ".gltf")
MAX_CORNERS = 15_000_000  # of triangles that a scene places, and vertices of the accessors that it uses
POSITION = "POSITION"


def read_gltf(path: Path) -> list[tuple[str, Mesh]]:
    """The named parts of a file's default scene, in the order of its nodes, parents first; names are unique.

    Vertices are float64 in the scene's frame and unit. Points and lines have no surface and are left out.
    Raises InputError for whatever can't be read, with the node, mesh and primitive where it is.
    """
    document, binary = load(path)
    nodes = [(i, pose) for i, pose in _Tree(path, document).placed() if document.nodes[i].mesh is not None]
    surfaces = _Surfaces(path, document, Numbers(path, document, binary))
    surfaces.check([i for i, _ in nodes])
    parts = [(_name(document, i), surfaces.placed(i, pose)) for i, pose in nodes]
    parts = [(name, mesh) for name, mesh in parts if len(mesh.faces)]
    if not parts:
        raise InputError(
            f"{path}: its scene has no faces ({len(nodes)} of its nodes have a mesh); wanted triangles, not only "
            "points or lines"
        )
    return list(zip(distinct_names(name for name, _ in parts), (mesh for _, mesh in parts), strict=True))


def _called(kind: str, i: int, name: str) -> str:
    return f"{kind} {i} ({name[:60]!r})" if name else f"{kind} {i}"


def _name(document: GltfJson, i: int) -> str:
    """A node's name, else its mesh's, else ""."""
    node = document.nodes[i]
    return node.name or ("" if node.mesh is None else document.meshes[node.mesh].name)


class _Tree:
    """The nodes of a file."""

    def __init__(self, path: Path, document: GltfJson) -> None:
        self._path = path
        self._document = document
        self._nodes = document.nodes
        self._check()

    def placed(self) -> Iterator[tuple[int, Float[ndarray, "4 4"]]]:
        """The default scene's nodes, parents first, children in order; and node → scene."""
        waiting = [(i, np.eye(4)) for i in reversed(self._roots())]
        while waiting:
            i, above = waiting.pop()
            with np.errstate(over="ignore", invalid="ignore"):
                pose = above @ self._pose(i)
            yield i, pose
            waiting += [(child, pose) for child in reversed(self._nodes[i].children)]

    def _pose(self, i: int) -> Float[ndarray, "4 4"]:
        where = f"{self._path}, {_called('node', i, self._nodes[i].name)}"
        try:
            pose = self._nodes[i].pose()
        except ValueError as error:
            raise InputError(f"{where}: its rotation is no unit quaternion ({error})") from error
        if not np.allclose(pose[3], [0, 0, 0, 1]):
            raise InputError(f"{where}: the last row of its matrix is {pose[3].tolist()}; wanted 0, 0, 0, 1")
        return pose

    def _roots(self) -> tuple[int, ...]:
        """Root nodes of the default scene, else of the first; without scenes all nodes that are no children."""
        scenes, scene = self._document.scenes, self._document.scene
        if not scenes and scene is None:
            return self._tops()
        chosen = scene or 0
        if chosen >= len(scenes):
            raise InputError(f"{self._path}: shows scene {chosen}; it has {len(scenes)}")
        return scenes[chosen].nodes

    def _tops(self) -> tuple[int, ...]:
        children = {child for node in self._nodes for child in node.children}
        return tuple(i for i in range(len(self._nodes)) if i not in children)

    def _check(self) -> None:
        """Raise InputError unless the nodes are trees, and the scene's nodes are roots, each once."""
        uses = Counter(child for node in self._nodes for child in node.children)
        roots = Counter(self._roots())
        for i, count in (uses + roots).items():
            if i >= len(self._nodes):
                raise InputError(f"{self._path}: names node {i}; it has {len(self._nodes)}")
            if count > 1:
                places = f"{uses[i]} times a child and {roots[i]} times a root of the scene"
                raise InputError(
                    f"{self._path}, {_called('node', i, self._nodes[i].name)}: is {places}; wanted one place in a tree"
                )
        reached = 0
        waiting = list(self._tops())
        while waiting:
            reached += 1
            waiting += self._nodes[waiting.pop()].children
        if reached < len(self._nodes):
            raise InputError(
                f"{self._path}: {len(self._nodes) - reached} of its nodes are below each other, in a cycle"
            )
        for i, node in enumerate(self._nodes):
            if node.mesh is not None and node.mesh >= len(self._document.meshes):
                raise InputError(
                    f"{self._path}, {_called('node', i, node.name)}: names mesh {node.mesh}; "
                    f"the file has {len(self._document.meshes)}"
                )


@dataclass(frozen=True)
class _Piece:
    """A primitive that is made of triangles."""

    where: str  # file, node, mesh and primitive
    blend: tuple[tuple[int, float], ...]  # accessors of positions with their weights: its own, then morph targets
    indices: int | None  # accessor
    mode: int  # TRIANGLES, STRIP or FAN
    count: int  # of indices, of vertices where there are none

    def corners(self) -> int:
        """Number of its triangles' corners."""
        return self.count if self.mode == TRIANGLES else 3 * max(self.count - 2, 0)


class _Surfaces:
    """The triangles of a file's meshes."""

    def __init__(self, path: Path, document: GltfJson, numbers: Numbers) -> None:
        self._path = path
        self._document = document
        self._numbers = numbers
        self._pieces: dict[tuple[int, tuple[float, ...]], list[_Piece]] = {}  # by mesh and weights
        self._meshes: dict[tuple[int, tuple[float, ...]], Mesh] = {}  # likewise; in the node's frame

    def check(self, nodes: list[int]) -> None:
        """Raise InputError for primitives that can't be read or are too many. The buffers aren't read yet."""
        keys = [self._key(i) for i in nodes]
        primitives = sum(len(self._document.meshes[mesh].primitives) for mesh, _ in keys)
        self._limit("primitives", primitives, MAX_ENTRIES)
        corners = 0
        used: set[int] = set()
        for i, (mesh, weights) in zip(nodes, keys, strict=True):
            if (mesh, weights) not in self._pieces:
                self._pieces[mesh, weights] = list(self._read_pieces(i, mesh, weights))
            pieces = self._pieces[mesh, weights]
            used.update(accessor for piece in pieces for accessor, _ in piece.blend)
            corners += sum(piece.corners() for piece in pieces)
            self._limit("corners of triangles", corners, MAX_CORNERS)
        self._limit("vertices", sum(self._document.accessors[accessor].count for accessor in used), MAX_CORNERS)

    def placed(self, i: int, pose: Float[ndarray, "4 4"]) -> Mesh:
        """A node's mesh in the scene's frame. A pose that mirrors would turn faces inside out: they are turned back."""
        key = self._key(i)
        if key not in self._meshes:
            self._meshes[key] = self._read_mesh(self._pieces[key])
        mesh = self._meshes[key]
        with np.errstate(over="ignore", invalid="ignore"):
            vertices = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
        if not (np.abs(vertices) <= MAX_COORDINATE).all():
            name = _called("node", i, self._document.nodes[i].name)
            raise InputError(f"{self._path}, {name}: its place makes coordinates too large for any number")
        mirrors = np.linalg.slogdet(pose[:3, :3])[0] < 0
        return Mesh(vertices, np.ascontiguousarray(mesh.faces[:, ::-1]) if mirrors else mesh.faces)

    def _key(self, i: int) -> tuple[int, tuple[float, ...]]:
        node = self._document.nodes[i]
        assert node.mesh is not None
        weights = node.weights if node.weights is not None else self._document.meshes[node.mesh].weights
        return node.mesh, weights or ()

    def _limit(self, what: str, count: int, most: int) -> None:
        if count > most:
            raise InputError(
                f"{self._path}: its scene has {count:,} {what} and more, at most {most:,} are read; simplify it"
            )

    def _read_pieces(self, i: int, mesh: int, weights: tuple[float, ...]) -> Iterator[_Piece]:
        """Primitives of a node's mesh without points and lines."""
        node, entry = self._document.nodes[i], self._document.meshes[mesh]
        owner = f"{self._path}, {_called('node', i, node.name)}"
        if node.skin is not None:
            raise InputError(f"{owner}: is skinned, so that joints move it; apply the armature and export again")
        for extension in sorted(FOREIGN.keys() & node.extensions.keys()):
            raise foreign(owner, extension)
        for j, primitive in enumerate(entry.primitives):
            where = f"{owner}, {_called('mesh', mesh, entry.name)}, primitive {j}"
            if primitive.mode > FAN:
                raise InputError(f"{where}: mode {primitive.mode} is none of glTF's, 0 to {FAN}")
            if primitive.mode >= TRIANGLES:
                yield self._read_piece(where, primitive, weights)

    def _read_piece(self, where: str, primitive: Primitive, weights: tuple[float, ...]) -> _Piece:
        if POSITION not in primitive.attributes:
            raise InputError(f"{where}: its vertices have no {POSITION}")
        positions = primitive.attributes[POSITION]
        count = self._numbers.entry(positions, where).count
        moved = [(target[POSITION], w) for target, w in zip(primitive.targets, weights) if w and POSITION in target]
        for target, _ in moved:
            if (other := self._numbers.entry(target, where).count) != count:
                raise InputError(f"{where}: a morph target has {other:,} vertices; wanted {count:,}")
        accessors = [positions] if primitive.indices is None else [positions, primitive.indices]
        if any(self._numbers.entry(accessor, where).is_bare() for accessor in accessors):
            for extension in sorted(FOREIGN.keys() & primitive.extensions.keys()):
                raise foreign(where, extension)
            for extension in sorted(primitive.extensions):
                raise InputError(f"{where}: only {extension[:60]} tells its numbers; export without it")
        count = self._numbers.entry(accessors[-1], where).count
        if (primitive.mode == TRIANGLES and count % 3) or (primitive.mode != TRIANGLES and count in (1, 2)):
            wanted = "a multiple of 3" if primitive.mode == TRIANGLES else "3 or more"
            raise InputError(f"{where}: has {count} corners; wanted {wanted} in mode {primitive.mode}")
        return _Piece(where, ((positions, 1.0), *moved), primitive.indices, primitive.mode, count)

    def _read_mesh(self, pieces: list[_Piece]) -> Mesh:
        """All primitives of a mesh; those that share their positions share vertices."""
        groups: dict[tuple[tuple[int, float], ...], list[_Piece]] = {}
        for piece in pieces:
            groups.setdefault(piece.blend, []).append(piece)
        meshes = []
        for blend, members in groups.items():
            faces = np.concatenate([_triangles(piece.mode, self._read_corners(piece)) for piece in members])
            used, numbered = np.unique(faces, return_inverse=True)
            vertices = np.zeros((len(used), 3))
            with np.errstate(over="ignore", invalid="ignore"):
                for accessor, weight in blend:
                    vertices += weight * self._numbers.positions(accessor, used, members[0].where)
            if not (finite := np.isfinite(vertices).all(axis=1)).all():
                raise InputError(f"{members[0].where}: vertex {used[finite.argmin()]} is not finite; export it again")
            meshes.append(Mesh(vertices, numbered.reshape(-1, 3).astype(np.int32)))
        return join(meshes)

    def _read_corners(self, piece: _Piece) -> Int[ndarray, " n"]:
        if piece.indices is None:
            return np.arange(piece.count)
        corners = self._numbers.indices(piece.indices, piece.where)
        known = self._document.accessors[piece.blend[0][0]].count
        if len(corners) and (largest := int(corners.max())) >= known:
            raise InputError(f"{piece.where}: a face names vertex {largest}; there are {known}, from 0")
        return corners


def _triangles(mode: int, corners: Int[ndarray, " n"]) -> Int[ndarray, "f 3"]:
    """Triangles of a list, or of a strip or fan without degenerate ones, wound as in the specification, §3.7.2.1."""
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    i = np.arange(max(len(corners) - 2, 0))
    odd = i % 2
    a, b, c = corners[np.stack([i, i + 1 + odd, i + 2 - odd] if mode == STRIP else [i + 1, i + 2, 0 * i])]
    return np.stack([a, b, c], axis=1)[(a != b) & (b != c) & (c != a)]
