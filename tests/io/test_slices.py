"""The picture of a slice: which points, seen how, and that the command draws it."""

from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError
from cagesdf.io.points import write_shard
from cagesdf.io.slices import MARGIN, THICKNESS, draw_slice, middle_slice
from tests.support import spheres


@pytest.fixture
def shard(tmp_path: Path) -> Path:
    path = tmp_path / "shape-0000.parquet"
    write_shard(path, [spheres.chunks((300, 20, 30, 40))], np.random.default_rng(0))
    return path


def test_a_slice_is_of_one_shape_and_step_and_near_a_plane_through_its_middle(shard: Path) -> None:
    found = middle_slice(shard)
    assert (found.shape_id, found.step) == ("large", 0)
    assert abs(found.at) < 0.01
    assert found.width == pytest.approx(2 * (0.6 + MARGIN), abs=0.06)  # few points are near the poles
    assert np.abs(found.places).max() <= found.width / 2 + 0.01
    # The distance of a sphere's points near the plane follows from their places, but for the slice's thickness.
    expected = np.linalg.norm(found.places, axis=1) - 0.6
    assert len(found.sdf) > 100
    assert np.abs(np.hypot(expected + 0.6, THICKNESS) - 0.6 - found.sdf).max() < THICKNESS


def test_the_plane_is_the_one_that_shows_most_of_the_inside(tmp_path: Path) -> None:
    """Of a thin plate across y, that is the plane that lies in it."""
    chunks = spheres.chunks((200, 0, 0, 0))
    chunks.sdf[:] = np.abs(chunks.xyz[..., 1]) - 0.02
    write_shard(tmp_path / "shape-0000.parquet", [chunks], np.random.default_rng(0))
    assert middle_slice(tmp_path / "shape-0000.parquet").axis == 1


def test_a_picture_is_a_png_and_the_same_twice(shard: Path, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_slice(middle_slice(shard), tmp_path / name)
    data = (tmp_path / "a.png").read_bytes()
    assert data.startswith(b"\x89PNG")
    assert data == (tmp_path / "b.png").read_bytes()


def test_a_shard_without_points_can_not_be_drawn(tmp_path: Path) -> None:
    write_shard(tmp_path / "shape-0000.parquet", [spheres.chunks((0, 0, 0, 0))], np.random.default_rng(0))
    with pytest.raises(InputError, match="holds no points to draw"):
        middle_slice(tmp_path / "shape-0000.parquet")
