"""Pictures show what they are told to, with or without OpenGL."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cagesdf import rendering
from cagesdf.cuboid import Cage, Cuboid
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import CUBE_FACES, cage_surface
from cagesdf.rendering import CAMERA, CLAY, Scene, View, draw_with_matplotlib, render_rows, side_by_side

SIZE = 64
ROOT = Path(__file__).parents[1]


def box(centre: tuple[float, float, float], size: float = 0.4) -> Cage:
    return Cage.of({"a": Cuboid(np.array(centre, dtype=float), np.eye(3), np.full(3, size))})


def surface(cage: Cage, colour: str = CLAY) -> Scene:
    return Scene((cage_surface(cage),), (colour,))


def middle(image: np.ndarray) -> np.ndarray:
    """Mean column and row of what is drawn."""
    rows, columns = np.nonzero(image[..., 3] > 128)
    return np.array([columns.mean(), rows.mean()])


def test_the_camera_is_a_rotation_that_looks_at_the_front_from_the_right_and_above() -> None:
    np.testing.assert_allclose(CAMERA @ CAMERA.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(CAMERA) > 0
    assert (CAMERA[2] > 0).all()
    assert CAMERA[1] @ [0, 1, 0] > 0.8, "y stays up"


def test_a_view_holds_every_point_of_its_scenes_and_no_more_than_it_must() -> None:
    scenes = [surface(box((0.5, 0.1, 0))), Scene(cage=box((-0.5, 0, 0.3)), cage_colours=("#ff0000",))]
    view = View.around(scenes)
    points = np.concatenate([scene.points() for scene in scenes]) @ CAMERA.T - view.centre
    assert 0.9 * view.half < np.abs(points[:, :2]).max() < view.half
    assert View.around([]).half == 1.0


def test_a_scene_needs_as_many_colours_as_things() -> None:
    with pytest.raises(ValueError, match="1 meshes and 0 cuboids needs as many colours, got 0 and 0"):
        Scene((Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)),))


def test_pictures_of_a_row_share_their_scale_and_the_background_is_transparent() -> None:
    scenes = [surface(box((0, 0, 0), 1.0)), surface(box((0, 0, 0), 0.5))]
    view = View.around(scenes)
    large, small = (np.count_nonzero(draw_with_matplotlib(scene, view, SIZE)[..., 3] > 128) for scene in scenes)
    assert small == pytest.approx(large / 4, rel=0.1)
    assert draw_with_matplotlib(scenes[0], view, SIZE)[0, 0, 3] == 0


def test_what_lies_higher_or_farther_right_is_drawn_so() -> None:
    scenes = [surface(box(centre)) for centre in [(0, 0, 0), (0, 0.5, 0), (0.5, 0, 0)]]
    origin, up, right = (middle(draw_with_matplotlib(scene, View.around(scenes), SIZE)) for scene in scenes)
    assert up[1] < origin[1] - 5
    assert right[0] > origin[0] + 5


def test_the_nearer_of_two_surfaces_hides_the_other_by_both_ways_of_drawing() -> None:
    front, back = cage_surface(box((0, 0, 0.5))), cage_surface(box((0, 0, -0.5), 0.8))
    towards = 0.5 * CAMERA[2]
    scene = Scene((back.with_vertices(back.vertices - towards), front), ("#ff0000", "#0000ff"))
    view = View(CAMERA @ [0, 0, 0.5], 0.1, 2.0)
    for image in (draw_with_matplotlib(scene, view, SIZE), rendering._render_all([(scene, view)], SIZE, 1)[0][0]):
        red, _, blue, alpha = image[SIZE // 2, SIZE // 2].astype(int)
        assert alpha == 255
        assert blue > red + 100


def test_large_triangles_are_divided_without_changing_what_they_cover() -> None:
    triangles = cage_surface(box((0, 0, 0), 1.0)).corners()
    pieces, colours = rendering._divided(triangles, np.arange(len(triangles) * 3.0).reshape(-1, 3), longest=0.3)

    def area(corners: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2

    assert np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2).max() <= 0.3
    assert area(pieces).sum() == pytest.approx(6.0)
    for i in range(len(triangles)):
        assert area(pieces[colours[:, 0] == 3 * i]).sum() == pytest.approx(0.5)
    assert (np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]) * pieces.mean(1)).sum(1).min() > 0


def test_cuboids_are_translucent_and_their_edges_are_not() -> None:
    scene = Scene(cage=box((0, 0, 0), 1.0), cage_colours=("#ff0000",))
    alpha = draw_with_matplotlib(scene, View.around([scene]), 200)[..., 3]
    assert 60 < np.median(alpha[alpha > 0]) < 200
    assert alpha.max() > 1.5 * np.median(alpha[alpha > 0])


def test_both_ways_of_drawing_agree_about_where_things_are() -> None:
    scenes = [surface(box((0.2, 0.1, 0))), surface(box((-0.4, -0.2, 0.3)))]
    (images,), drawn_by = render_rows([scenes], SIZE)
    if drawn_by == "matplotlib":
        pytest.skip("no OpenGL here")
    for scene, image in zip(scenes, images):
        fallback = draw_with_matplotlib(scene, View.around(scenes), SIZE)
        np.testing.assert_allclose(middle(image), middle(fallback), atol=1)
        assert np.mean((image[..., 3] > 128) != (fallback[..., 3] > 128)) < 0.03


def test_the_same_scenes_give_the_same_pictures() -> None:
    rows = [[surface(box((0, 0, 0))), Scene(cage=box((0, 0.2, 0)), cage_colours=("#00ff00",))], []]
    (first, empty), _ = render_rows(rows, SIZE)
    (second, _), _ = render_rows(rows, SIZE, processes=2)
    assert empty == []
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_picture_does_not_depend_on_those_drawn_before_it() -> None:
    cage = box((0, 0.2, 0))
    boxes = Scene(cage=cage, cage_colours=("#00ff00",))
    both = Scene((cage_surface(cage),), ("#0000ff",), cage, ("#00ff00",))
    scenes = [surface(cage, "#ff0000"), boxes, both]
    order = (2, 0, 1, 1, 0, 2)
    alone = [render_rows([[scene]], 32)[0][0][0] for scene in scenes]
    rows, _ = render_rows([[scenes[i]] for i in order], 32)
    for i, (picture,) in zip(order, rows):
        np.testing.assert_array_equal(picture, alone[i])


@pytest.mark.parametrize("windows", [(), ("vtkNoSuchRenderWindow",)])
def test_matplotlib_draws_where_opengl_does_not(windows: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "WINDOWS", windows)
    monkeypatch.setattr(rendering, "draw_with_vtk", _crash)
    (images,), drawn_by = render_rows([[surface(box((0, 0, 0)))]], SIZE)
    assert drawn_by == "matplotlib"
    assert images[0][SIZE // 2, SIZE // 2, 3] == 255


def _crash(*_: object) -> None:
    """Die as VTK does without EGL, so that no exception tells of it."""
    import os
    import signal

    os.kill(os.getpid(), signal.SIGSEGV)


def test_an_empty_mesh_is_an_empty_picture() -> None:
    nothing = Scene((Mesh(np.zeros((0, 3)), CUBE_FACES[:0]),), (CLAY,))
    (images,), _ = render_rows([[nothing]], SIZE)
    assert not images[0][..., 3].any()


def test_pictures_side_by_side_fill_rows_on_white() -> None:
    red, clear = np.zeros((2, 4, 4, 4), np.uint8)
    red[...] = [255, 0, 0, 255]
    page = side_by_side([clear, red, red], 2)
    assert page.shape == (8, 8, 3)
    assert (page[:4, :4] == 255).all()
    assert (page[:4, 4:] == [255, 0, 0]).all()
    assert (page[4:, :4] == [255, 0, 0]).all()
    assert (page[4:, 4:] == 255).all()


def test_a_script_that_draws_runs_once(tmp_path: Path) -> None:
    """Processes that draw don't run the user's script again, which has no guard."""
    script = tmp_path / "script.py"
    script.write_text(
        "import numpy as np\n"
        "from cagesdf.cuboid import Cage, Cuboid\n"
        "from cagesdf.rendering import Scene, render_rows\n"
        "print('begun')\n"
        "cage = Cage.of({'a': Cuboid(np.zeros(3), np.eye(3), np.ones(3))})\n"
        "[[picture]], drawn_by = render_rows([[Scene(cage=cage, cage_colours=('#ff0000',))]], 32)\n"
        "print(drawn_by, picture[..., 3].any())\n"
    )
    done = subprocess.run([sys.executable, script], cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    begun, drawn = done.stdout.splitlines()
    assert begun == "begun"
    assert drawn.endswith(" True")
