"""The parts that a union's faces come from, against distances to the parts' surfaces."""

import numpy as np
import pytest
import trimesh

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.extraction import face_owners
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import union
from tests.support import toy


def ball(centre: list[float], radius: float) -> Mesh:
    sphere = trimesh.creation.icosphere(4, radius)
    return Mesh(sphere.vertices + centre, sphere.faces.astype(np.int32))


def around(mesh: Mesh) -> Cuboid:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return Cuboid((low + high) / 2, np.eye(3), high - low)


PARTS = {
    "seat": toy.box([0, 0, 0], [1, 0.1, 1]),
    "knob": ball([0.1, 0.08, 0.05], 0.3),
    "other": ball([0.3, 0.12, 0.1], 0.25),
}


@pytest.mark.parametrize("order", [("seat", "knob", "other"), ("other", "seat", "knob")])
def test_a_face_belongs_to_the_part_whose_surface_it_lies_on(order: tuple[str, ...]) -> None:
    parts = {part: PARTS[part] for part in order}
    cage = Cage.of({part: around(mesh) for part, mesh in parts.items()})
    whole = union(list(parts.values()))
    owners = face_owners(whole, {part: parts[part] for part in reversed(order)}, cage)
    centres = whole.corners().mean(axis=1)
    distances = np.array([SurfaceDistance(parts[part]).unsigned(centres) for part in cage.part_ids])
    kept = {vertex.tobytes() for mesh in parts.values() for vertex in mesh.vertices + 0.0}
    known = np.array([vertex.tobytes() in kept for vertex in whole.vertices + 0.0])[whole.faces].any(axis=1)
    assert known.mean() > 0.9
    assert (distances[owners, np.arange(len(owners))][known] < 1e-9).all()
    assert set(owners.tolist()) == {0, 1, 2}
    assert (np.sort(distances, axis=0)[1] > 1e-6).mean() > 0.9  # most faces lie on one surface alone


def test_a_surface_without_faces_has_no_owners() -> None:
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    cage = Cage.of({part: around(mesh) for part, mesh in PARTS.items()})
    assert len(face_owners(nothing, dict.fromkeys(PARTS, nothing), cage)) == 0
