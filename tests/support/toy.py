"""Shapes built in code: small, closed, of known structure."""

from pathlib import Path
from typing import TypedDict

import manifold3d
import numpy as np

from cagesdf.cuboid import Cage
from cagesdf.frames import canonical_similarity
from cagesdf.geometry.meshes import Mesh, signed_volume
from cagesdf.geometry.solid import from_manifold
from cagesdf.io.shapes import write_shapes
from cagesdf.shape import Part, Repair, Shape
from cagesdf.shape_generation.generated import GeneratedShape
from cagesdf.structure.hierarchy import Node, PartHierarchy
from pipeline import Params, artefact


def box(centre, size) -> Mesh:
    """An axis-aligned box."""
    return from_manifold(manifold3d.Manifold.cube(list(size), True).translate(list(centre)))


def ball(centre, radius: float, segments: int = 32) -> Mesh:
    """A sphere of triangles."""
    return from_manifold(manifold3d.Manifold.sphere(radius, segments).translate(list(centre)))


def rod(bottom, top, radius: float, taper: float = 0.7, segments: int = 24) -> Mesh:
    """A tapered cylinder between two points."""
    along = np.subtract(top, bottom)
    length = float(np.linalg.norm(along))
    z = along / length
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    pose = np.column_stack([x, np.cross(z, x), z, bottom])
    return from_manifold(manifold3d.Manifold.cylinder(length, radius, radius * taper, segments).transform(pose))


def shape_of(shape_id: str, meshes: dict[str, Mesh], tree: Node, split: str = "train") -> Shape:
    """A shape of closed meshes by part id, brought into the canonical frame."""
    labels = {node.node_id: node.label for node in tree.walk()}
    similarity = canonical_similarity(np.concatenate([mesh.vertices for mesh in meshes.values()]), "y")
    structure = PartHierarchy(tree)
    parts = []
    for part_id in structure.parts():
        mesh = meshes[part_id].with_vertices(similarity.to_canonical(meshes[part_id].vertices))
        repair = Repair(
            "none", len(mesh.faces), len(mesh.faces), signed_volume(mesh), 0.5, dropped=0, plates=0, lost=0.0
        )
        parts.append(Part(part_id, labels[part_id], mesh, repair))
    return Shape(shape_id, split, tuple(parts), structure, similarity)


def stool(
    shape_id: str, split: str = "train", width: float = 1.0, height: float = 1.0, legs: int = 4, lean: float = 0.1
) -> Shape:
    """A seat on tapered legs that lean outwards and reach into the seat."""
    angles = (np.arange(legs) + 0.5) / legs * 2 * np.pi
    meshes = {"seat": box([0, height, 0], [width, 0.1, 0.8])}
    for k, angle in enumerate(angles):
        foot = np.array([0.4 * width * np.cos(angle), 0, 0.32 * np.sin(angle)])
        meshes[f"leg{k}"] = rod(foot * (1 + lean), foot + np.array([0, height, 0]), 0.05)
    base = Node("base", "base", tuple(Node(f"leg{k}", "leg", (), (), None) for k in range(legs)), (), None)
    tree = Node("root", "stool", (Node("seat", "seat", (), (), None), base), (), None)
    return shape_of(shape_id, meshes, tree, split)


def generated(method: str, shape_id: str, mesh: Mesh, points: np.ndarray, components: int = 1) -> GeneratedShape:
    """A generated shape of an arm without cuboids."""
    return GeneratedShape(
        method, shape_id, 0, 0, None, Cage.from_vectors((), np.zeros((0, 15))), 0, np.zeros(2, np.float32), {}, 1.0,
        "ok" if len(mesh.faces) else "empty", mesh, components, 0.0, 1, rooted=False, stable=False, points=points,
        parts={"shape": mesh},
    )  # fmt: skip


class Limits(TypedDict):
    """Limits of `import_shape`, in canonical units."""

    weld: float
    max_faces: int
    max_parts: int
    min_thickness: float


def write_shapes_artefact(out: Path, shapes: list[Shape]) -> Path:
    """An artefact as import_shapes leaves it."""
    with artefact.write("shapes", out, inputs={}, params=Params(format=1)) as folder:
        write_shapes(folder, shapes)
    return out


def write_obj(path: Path, mesh: Mesh) -> None:
    """A mesh as an OBJ file; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
