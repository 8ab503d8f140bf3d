"""Surfaces on disk: what comes back, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.errors import InputError
from cagesdf.frames import UP_AXES, Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.io.meshes import Surface, read_ply, read_surfaces, write_ply, write_surfaces
from tests.support import toy

EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
SIMILARITY = Similarity(0.01, UP_AXES["z"], np.array([0.1, 0.2, 0.3]))


def surface(shape_id: str = "a", step: int = 0, mesh: Mesh | None = None) -> Surface:
    return Surface(shape_id, step, step == 2, mesh or toy.ball([0.1, 0, 0], 0.5), 0.25, 1234, SIMILARITY, 3, 2, 1e-5)


@given(vertices=st.integers(0, 40), faces=st.integers(0, 60), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_a_ply_file_gives_its_mesh_back_in_single_precision(
    tmp_path_factory: pytest.TempPathFactory, vertices: int, faces: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    faces = faces if vertices else 0
    mesh = Mesh(rng.normal(size=(vertices, 3)), rng.integers(0, max(vertices, 1), (faces, 3)).astype(np.int32))
    path = tmp_path_factory.mktemp("ply") / "mesh.ply"
    write_ply(path, mesh)
    back = read_ply(path)
    np.testing.assert_array_equal(back.vertices, mesh.vertices.astype(np.float32))
    np.testing.assert_array_equal(back.faces, mesh.faces)
    assert back.faces.dtype == np.int32


def test_other_programs_read_the_ply_file(tmp_path: Path) -> None:
    mesh = toy.ball([0.1, 0, 0], 0.5)
    write_ply(tmp_path / "ball.ply", mesh)
    other = trimesh.load_mesh(tmp_path / "ball.ply", process=False)
    np.testing.assert_array_equal(other.faces, mesh.faces)
    np.testing.assert_allclose(other.vertices, mesh.vertices, atol=1e-7)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-1],
        lambda content: content + b"\0",
        lambda content: b"",
        lambda content: content.replace(b"binary_little_endian", b"ascii"),
        lambda content: content.replace(b"float x", b"double x"),
        lambda content: content[:-4] + b"\xff\xff\xff\x7f",
        lambda content: content[:-13] + b"\x04" + content[-12:],
        lambda content: content.replace(b"end_header\n", b"end_header\n\xff\xff\xff\xff", 1)[:-4],
    ],
    ids=["short", "long", "empty", "ascii", "double", "index", "polygon", "shifted"],
)
def test_a_foreign_or_damaged_ply_file_is_refused_by_name(tmp_path: Path, damage) -> None:
    path = tmp_path / "ball.ply"
    write_ply(path, toy.ball([0, 0, 0], 0.5))
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError, match=r"ball\.ply"):
        read_ply(path)


def test_surfaces_come_back_with_all_that_is_known_of_them(tmp_path: Path) -> None:
    write_surfaces(tmp_path, [surface("b/c d", 3), surface("a", 2), surface("a", 0, EMPTY)])
    folder = read_surfaces(tmp_path)
    assert list(folder.rows) == [("a", 0), ("a", 2), ("b/c d", 3)]
    assert [row["closed"] for row in folder.rows.values()] == [False, True, True]
    for back in folder:
        row = folder.rows[back.shape_id, back.step]
        assert (row["vertices"], row["faces"]) == (len(back.mesh.vertices), len(back.mesh.faces))
        assert (back.held_out, back.clipped, back.evaluations) == (back.step == 2, 0.25, 1234)
        assert (back.components, back.dropped, back.overshoot) == (3, 2, 1e-5)
        assert back.similarity.to_numbers() == SIMILARITY.to_numbers()
    with pytest.raises(InputError, match="shape 'a', step 1"):
        folder.read("a", 1)


def test_the_users_frame_undoes_the_similarity() -> None:
    there = surface()
    back = SIMILARITY.to_canonical(there.in_raw().vertices)
    np.testing.assert_allclose(back, there.mesh.vertices, atol=1e-12)
    assert np.ptp(there.in_raw().vertices, axis=0).max() == pytest.approx(100)


def test_a_surface_with_a_hole_is_not_written(tmp_path: Path) -> None:
    mesh = toy.ball([0, 0, 0], 0.5)
    with pytest.raises(ValueError, match=r"shape a, step 4.*not closed"):
        write_surfaces(tmp_path, [surface("a", 4, replace(mesh, faces=mesh.faces[1:]))])
