"""The editor in a real browser: what a visitor does, and what comes of it."""

import io
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Dialog

from cagesdf.cli.surfaces import edit, mix
from cagesdf.cuboid import Cage, Cuboid
from cagesdf.demo import DEMO
from cagesdf.editing.links import mirrors
from cagesdf.editing.parts import part_names
from cagesdf.editing.session import Session
from cagesdf.editing.state import State
from cagesdf.formats.obj import read_obj_groups
from cagesdf.geometry.meshes import is_closed
from cagesdf.io.runs import read_run
from cagesdf.structure.stored import read_structure
from cagesdf.viewing.picking import along, entries
from cagesdf.viewing.scene import GIZMO_PIXELS, handle_place
from cagesdf.viewing.server import Editor
from tests.support.page import CENTRE, LENGTHS, ROTATION, Camera, EditorPage

pytestmark = pytest.mark.slow
VISITORS = 6  # at once
Visit = Callable[[], EditorPage]


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(read_run(DEMO / "run"))


@pytest.fixture(scope="module")
def mirrored(session: Session) -> tuple[str, str, str]:
    """A shape, and two of its parts, by name, that mirror each other."""
    for shape_id in sorted(session.run.sequences):
        state = session.opened(shape_id)
        names = part_names(state.structure)
        for part, others in mirrors(state).items():
            for other in others:
                return shape_id, names[part], names[other]
    raise AssertionError("the demo has no mirrored parts")


def state_of(session: Session, page: EditorPage) -> State:
    return session.opened(page.value("Shape"))


def camera_of(editor: Editor) -> Camera:
    """Of the page that came last."""
    client = editor.server.get_clients()[max(editor.server.get_clients())]
    return Camera(
        np.array(client.camera.position), np.array(client.camera.look_at), client.camera.fov, client.camera.image_height
    )


def grip(cuboid: Cuboid, camera: Camera) -> np.ndarray:
    """A point of the gizmo's arrow that goes upwards most."""
    return (
        cuboid.centre
        + 0.9 * GIZMO_PIXELS * camera.pixel_at(cuboid.centre) * cuboid.axes[int(np.abs(cuboid.axes[:, 1]).argmax())]
    )


def by_name(state: State, name: str) -> str:
    return next(part for part, own in part_names(state.structure).items() if own == name)


def test_it_loads_without_errors_or_requests_to_others(visit: Visit, editor: Editor) -> None:
    page = visit()
    hosts = {urlsplit(url).netloc for url in page.requests if urlsplit(url).scheme in ("http", "https", "ws")}
    assert hosts == {urlsplit(editor.address).netloc}
    assert "128 cells" in page.status
    page.picture("opened")


def test_a_click_selects_the_cuboid_under_it(visit: Visit, editor: Editor, session: Session) -> None:
    page = visit()
    state, camera = state_of(session, page), camera_of(editor)
    point = state.cage.centre[int(state.cage.size.prod(axis=1).argmax())]
    name = part_names(state.structure)[camera.first_hit(state.cage, point)]
    page.page.mouse.click(*page.pixel(point, camera))
    page.until(lambda: page.status == f"selected: {name}", f"{name} selected")
    np.testing.assert_allclose(
        page.numbers(CENTRE), state.similarity.to_raw(state.cage[by_name(state, name)].centre[None])[0], atol=1e-3
    )


def test_clicks_reach_what_is_behind_and_shift_takes_more(visit: Visit, editor: Editor, session: Session) -> None:
    page = visit()
    state, camera = state_of(session, page), camera_of(editor)
    names = part_names(state.structure)
    aim, behind = _clear_of_gizmos(state.cage, camera)
    at = page.pixel(aim, camera)
    for part in (*behind, behind[0]):
        page.drawn(10)
        page.page.mouse.click(*at)
        page.until(partial(_says, page, f"selected: {names[part]}"), f"{names[part]} selected")
    page.click_nothing()
    page.until(lambda: page.status == "selected: nothing", "nothing selected")
    page.select(names[behind[1]])
    page.page.keyboard.down("Shift")
    page.page.mouse.click(*at)
    page.page.keyboard.up("Shift")
    page.until(lambda: page.status == f"selected: {names[behind[1]]}, {names[behind[0]]}", "both selected")


def _says(page: EditorPage, status: str) -> bool:
    return page.status == status


def _clear_of_gizmos(cage: Cage, camera: Camera) -> tuple[np.ndarray, tuple[str, ...]]:
    """A point on a way through two cuboids, far from the gizmos of both, and some pixels from the cuboids' edges."""
    for aim in np.random.default_rng(0).uniform(-0.5, 0.5, (10_000, 3)):
        way = (aim - camera.position) / np.linalg.norm(aim - camera.position)
        behind = along(cage, camera.position, way)
        if len(behind) == 2:
            near = [(cage[part].centre, 1.2 * GIZMO_PIXELS * camera.pixel_at(cage[part].centre)) for part in behind]
            beside = 4 * camera.pixel_at(aim) * np.concatenate([np.eye(3), -np.eye(3)])
            if all(np.linalg.norm(np.cross(place - camera.position, way)) > radius for place, radius in near) and all(
                along(cage, camera.position, way_beside) == behind for way_beside in aim + beside - camera.position
            ):
                return aim, behind
    raise AssertionError("gizmos and handles are everywhere")


def test_dragging_an_arrow_moves_the_cuboid_and_undo_brings_the_very_same_surface_back(
    visit: Visit, editor: Editor, session: Session, tmp_path: Path
) -> None:
    page = visit()
    state, camera = state_of(session, page), camera_of(editor)
    ways = {part: grip(state.cage[part], camera) - camera.position for part in state.cage.part_ids}
    before_it = {part: (entries(state.cage, camera.position, way) < 0.99).sum() for part, way in ways.items()}
    part = max(before_it, key=before_it.__getitem__)
    assert before_it[part] >= 2  # the arrow is grasped through others
    name = part_names(state.structure)[part]
    before, cuboid = page.settled(), state.cage[part]
    page.select(name)
    start = page.numbers(CENTRE)
    page.drawn(10)
    at, to = page.pixel(grip(cuboid, camera), camera), page.pixel(2 * grip(cuboid, camera) - cuboid.centre, camera)
    way = np.subtract(to, at) / np.linalg.norm(np.subtract(to, at)) * 60
    page.drag(at, (float(way[0]), float(way[1])))
    after = page.settled(before)
    page.picture("moved")
    assert np.abs(page.numbers(CENTRE) - start).max() > 0.01
    assert [operation["op"] for operation in page.script(tmp_path)] == ["move"]
    page.press("Undo")
    page.until(lambda: page.surface == before, "the surface of before")
    page.press("Redo")
    page.until(lambda: page.surface == after, "the surface of after")


def test_dragging_a_face_resizes_the_cuboid_and_its_mirrored_partner(
    visit: Visit, editor: Editor, session: Session, mirrored: tuple[str, str, str]
) -> None:
    page = visit()
    shape_id, name, other = mirrored
    if page.value("Shape") != shape_id:
        before = page.settled()
        page.choose("Shape", shape_id)
        page.settled(before)
    state, camera = state_of(session, page), camera_of(editor)
    before = page.settled()
    page.select(other)
    partner = page.numbers(LENGTHS)
    page.select(name)
    lengths = page.numbers(LENGTHS)
    page.choose("Tool", "Resize")
    page.drawn(10)
    cuboid = state.cage[by_name(state, name)]
    axis, side = _nearest_face(state.cage, by_name(state, name), camera)
    ball = handle_place(cuboid, axis, side)
    at, to = page.pixel(ball, camera), page.pixel(1.5 * ball - 0.5 * cuboid.centre, camera)
    way = np.subtract(to, at) / np.linalg.norm(np.subtract(to, at)) * 40
    page.drag(at, (float(way[0]), float(way[1])))
    page.settled(before)
    page.picture("resized")
    changed = page.numbers(LENGTHS)
    assert np.sort(changed / lengths)[-1] > 1.02
    page.select(other)
    np.testing.assert_allclose(np.sort(page.numbers(LENGTHS) / partner), np.sort(changed / lengths), rtol=0.02)


def _nearest_face(cage: Cage, part: str, camera: Camera) -> tuple[int, int]:
    """An axis and a side of a cuboid whose handle no other cuboid hides; the longest way across the picture first."""
    cuboid = cage[part]
    faces = []
    for axis in range(3):
        for side in (-1, 1):
            handle = handle_place(cuboid, axis, side)
            steps = np.linspace(0, 0.98, 2000)[:, None] * (handle - camera.position) + camera.position
            if not (cage.signed_distance(steps) <= 0).any():
                across = np.linalg.norm((camera.frame() @ (side * cuboid.axes[axis]))[:2])
                faces.append((across, axis, side))
    assert faces, "all handles are hidden"
    return max(faces)[1:]


def test_the_style_changes_the_surface_and_not_the_cuboids(visit: Visit, session: Session, tmp_path: Path) -> None:
    page = visit()
    before = page.settled()
    name = next(iter(part_names(state_of(session, page).structure).values()))
    page.select(name)
    centre, lengths = page.numbers(CENTRE), page.numbers(LENGTHS)
    page.tab("Style")
    page.slide("Direction 1", 1.0)
    page.settled(before)
    page.picture("style")
    page.tab("Cuboids")
    np.testing.assert_array_equal(page.numbers(CENTRE), centre)
    np.testing.assert_array_equal(page.numbers(LENGTHS), lengths)
    assert [operation["op"] for operation in page.script(tmp_path)] == ["style"]


def test_the_legs_of_one_chair_stand_under_another_and_the_rest_stays_the_same_to_the_last_bit(
    visit: Visit, session: Session, tmp_path: Path
) -> None:
    page = visit()
    state, before = state_of(session, page), page.settled()
    legs = {name for part, name in part_names(state.structure).items() if state.structure.labels()[part] == "leg"}
    other = next(
        shape_id
        for shape_id, shape in session.styles.shapes.items()
        if "leg" in shape.structure.labels().values() and shape.structure.signature() != state.structure.signature()
    )
    page.tab("File")
    page.choose("Format", "obj")
    parts = dict(read_obj_groups(page.download("Export", tmp_path)))
    page.press("all 4: leg")
    page.until(lambda: page.status == f"selected: {', '.join(sorted(legs))}", "all legs selected")
    page.tab("Style")
    page.page.get_by_text(f"its style for {', '.join(sorted(legs))}").wait_for()
    page.choose("Style of", other)
    after = page.settled(before)
    page.picture("mixed")
    assert [operation["op"] for operation in page.script(tmp_path)] == ["mix"]
    mixed = page.download("Export", tmp_path)
    of_mixed = dict(read_obj_groups(mixed))
    assert of_mixed.keys() == parts.keys()
    assert all(is_closed(mesh) for mesh in of_mixed.values())
    assert legs == {
        name
        for name, mesh in of_mixed.items()
        if (mesh.vertices.tobytes(), mesh.faces.tobytes())
        != (parts[name].vertices.tobytes(), parts[name].faces.tobytes())
    }
    mix(DEMO / "run", page.value("Shape"), [f"leg={other}"], tmp_path / "command.obj")
    assert (tmp_path / "command.obj").read_bytes() == mixed.read_bytes()
    page.choose("Format", "ply")
    assert trimesh.load_mesh(page.download("Export", tmp_path)).is_watertight
    page.tab("Style")
    page.slide("Towards it", 0.5)
    half = page.settled(after)
    assert [operation["weight"] for operation in page.script(tmp_path)] == [0.5]
    assert half not in (before, after)
    page.press("Undo")
    page.until(lambda: page.surface == before, "the surface of before")


def test_an_export_is_a_closed_mesh_and_a_reloaded_script_and_the_command_give_the_same(
    visit: Visit, session: Session, tmp_path: Path
) -> None:
    page = visit()
    opened = page.settled()
    name = next(iter(part_names(state_of(session, page).structure).values()))
    page.select(name)
    page.set_number(LENGTHS, 0, float(page.numbers(LENGTHS)[0] * 1.2))
    first = page.settled(opened)
    page.tab("Style")
    page.choose("Style of", max(session.styles.shapes))
    after = page.settled(first)
    page.tab("File")
    page.choose("Format", "ply")
    mesh = page.download("Export", tmp_path)
    script = page.download("Save script", tmp_path)
    assert trimesh.load_mesh(mesh).is_watertight
    edit(DEMO / "run", page.value("Shape"), script, tmp_path / "command.ply")
    assert (tmp_path / "command.ply").read_bytes() == mesh.read_bytes()
    other = visit()
    other.tab("File")
    other.upload("Load script", "script.json", script.read_bytes())
    other.until(lambda: other.surface == after, "the surface of the script")


def test_a_new_shape_has_a_picture_and_outlives_its_page_which_asks_before_it_is_left(visit: Visit) -> None:
    page = visit()
    before, opened = page.settled(), page.value("Shape")
    page.tab("Style")
    page.until(lambda: page.drawn_tile(opened), "a picture of the style")
    page.picture("styles")
    page.tab("Shapes")
    page.press("New shape")
    page.until(lambda: page.value("Shape") == "new", "a new shape")
    first = page.settled()
    page.until(lambda: page.drawn_tile("new"), "a picture of it")
    page.picture("generated")
    page.choose("Shape", opened)
    page.until(lambda: page.surface == before, "the surface at first")
    page.press("new")
    page.until(lambda: page.surface == first, "the new shape")
    asked: list[str] = []

    def accept(dialog: Dialog) -> None:
        asked.append(dialog.type)
        dialog.accept()

    page.page.on("dialog", accept)
    page.page.reload(wait_until="commit")
    page.page.get_by_role("button", name="Continue new: as it was made").click()
    page.until(lambda: page.value("Shape") == "new" and page.surface == first, "the new shape again")
    page.picture("continued")
    assert asked == ["beforeunload"]
    page.press("Undo")
    page.refused("nothing to take back")


def test_parts_from_files_come_in_and_go_out_in_their_own_frame(visit: Visit, tmp_path: Path) -> None:
    page = visit()
    before = page.settled()
    page.tab("File")
    parts = {"seat": ([400, 40, 400], [1000, 400, 0]), "back": ([400, 500, 40], [1000, 670, -180])}
    for i, (x, z) in enumerate([(820, -180), (1180, -180), (820, 180), (1180, 180)]):
        parts[f"leg_{i}"] = ([40, 380, 40], [x, 190, z])
    with zipfile.ZipFile(tmp_path / "stool.zip", "w") as archive:
        for name, (extents, centre) in parts.items():
            mesh = trimesh.creation.box(extents)
            mesh.apply_translation(centre)
            archive.writestr(f"stool/{name}.stl", mesh.export(file_type="stl"))
    page.upload("Load parts", "stool.zip", (tmp_path / "stool.zip").read_bytes())
    page.page.get_by_text("6 cuboids").wait_for()
    page.settled(before)
    page.page.get_by_text("from the file's surface").wait_for()
    assert page.value("Shape") == "stool"
    page.tab("View")
    page.slide("True shape", 0.5)
    page.picture("uploaded")
    build, style = page.script(tmp_path)
    assert (build["op"], style["op"]) == ("build", "style")
    assert style["residuals"].keys() == read_structure(build["structure"]).cage().cuboids().keys()
    page.tab("Cuboids")
    page.select("back")
    np.testing.assert_allclose(page.numbers(CENTRE), [1000, 670, -180], atol=5)
    np.testing.assert_allclose(page.numbers(LENGTHS), [400, 500, 40], rtol=0.05)
    page.tab("File")
    mesh = trimesh.load_mesh(page.download("Export", tmp_path))
    assert np.all(mesh.bounds[0] > [790, -10, -210])
    assert np.all(mesh.bounds[1] < [1210, 930, 210])
    page.upload("Load parts", "bad.zip", b"PK")
    page.refused("can't be read as a zip")
    page.picture("parts")


def test_visitors_don_t_disturb_each_other_and_leave_nothing_behind(visit: Visit, editor: Editor) -> None:
    others = []
    for _ in range(VISITORS - 2):
        others.append(visit())
        others[-1].to_background()
    one, other = visit(), visit()
    surface = other.settled()
    one.tab("File")
    one.upload("Load script", "bad.json", b'[{"op": "move", "part": "wing", "by": [0, 0, 0]}]')
    one.refused("no part is called")
    one.upload("Load program", "bad.txt", b"import os")
    one.until(lambda: "bad.txt" in one.refusals and "no part is called" not in one.refusals, "the last one said alone")
    assert one.surface == other.surface == surface
    before = editor.tabs
    one.close()
    other.until(lambda: editor.tabs == before - 1, "the closed tab freed")
    other.to_background()
    styles = {surface}
    for page in (*others, other):
        page.to_front()
        page.tab("Style")
        page.press("Surprise me")
        styles.add(page.settled(surface))
        page.to_background()
    assert len(styles) == VISITORS


def part_buttons(page: EditorPage) -> list[str]:
    """Names in the list of parts."""
    labels = page.page.locator(".mantine-Button-root").all_inner_texts()
    known = {label.removeprefix("▸ ") for label in labels}
    return sorted(name for name in known if name.rpartition("_")[2].isdecimal() or "surface" in name)


def pixel_of(page: EditorPage, at: tuple[float, float]) -> np.ndarray:
    """The colour that is seen there."""
    with Image.open(io.BytesIO(page.page.screenshot())) as picture:
        return np.array(picture.convert("RGB"))[round(at[1]), round(at[0])].astype(int)


def test_the_list_selects_without_changing_the_surface_s_colours_and_keys_copy_delete_and_undo(
    visit: Visit, editor: Editor, session: Session, tmp_path: Path
) -> None:
    page = visit()
    state, camera = state_of(session, page), camera_of(editor)
    names = part_names(state.structure)
    assert part_buttons(page) == sorted(names.values())
    seat = state.cage[by_name(state, "seat_surface")]
    # On its upper side, beside the gizmo.
    at = page.pixel(seat.centre + np.array([-0.32, 0.5, 0.0]) * seat.size, camera)
    page.drawn(5)
    before = pixel_of(page, at)
    page.press("seat_surface")
    page.until(lambda: page.status == "selected: seat_surface", "the seat selected")
    page.drawn(5)
    assert np.abs(pixel_of(page, at) - before).max() <= 8
    page.picture("selected")
    page.press("back_surface")
    page.until(lambda: page.status == "selected: back_surface", "the back selected")
    surface = page.settled()
    page.page.keyboard.press("n")
    page.until(lambda: "copied" in page.status or "cells" in page.status, "a copy")
    page.until(lambda: "back_surface_2" in part_buttons(page), "the copy in the list")
    copied = page.settled(surface)
    page.picture("copied")
    page.page.keyboard.press("Delete")
    page.until(lambda: len(part_buttons(page)) == len(names), "the copy gone")
    page.page.keyboard.press("Control+z")
    page.until(lambda: page.surface == copied, "the copy back")
    assert [operation["op"] for operation in page.script(tmp_path)] == ["duplicate", "delete", "undo"]
    page.page.keyboard.press("i")
    page.page.get_by_text("Frame the selection".lower()).wait_for()
    page.picture("keys")


def test_a_higher_seat_takes_legs_along_and_what_can_not_be_is_said_until_it_is_dismissed(
    visit: Visit, session: Session, tmp_path: Path
) -> None:
    page = visit()
    before, state = page.settled(), state_of(session, page)
    page.select("leg_1")
    length = page.numbers(LENGTHS)[1]
    page.select("seat_surface")
    place = page.control("Status").first.bounding_box()
    page.set_number(CENTRE, 1, float(page.numbers(CENTRE)[1] + 0.05))
    page.settled(before)
    page.select("leg_1")
    assert page.numbers(LENGTHS)[1] > length + 0.04
    page.picture("higher")
    page.set_number(LENGTHS, 1, 0)
    page.refused(f"lengths are at least {1e-3 / state.similarity.scale:.1g}")
    assert "http" not in page.refusals
    page.picture("refused")
    assert page.control("Status").first.bounding_box() == place
    page.set_number(ROTATION, 1, 10)
    page.until(lambda: abs(page.numbers(ROTATION)[1] - 10) < 0.01, "the leg turned")
    page.refused("lengths are at least")
    kinds = [(operation["op"], operation["attach"]) for operation in page.script(tmp_path)]
    assert kinds[0] == ("move", True)
    assert {kind for kind, _ in kinds[1:]} == {"rotate"}


def test_numbers_are_those_that_were_typed_letter_by_letter(visit: Visit, tmp_path: Path) -> None:
    page = visit()
    page.settled()
    page.select("seat_surface")
    start = page.numbers(CENTRE)
    for text in ("0.02", "-0.015"):
        page.type_number(CENTRE, 1, text)
    page.type_number(CENTRE, 2, "-0,05")
    wanted = np.array([start[0], -0.015, -0.05])
    page.until(
        lambda: page.status.endswith(" s") and np.abs(page.numbers(CENTRE) - wanted).max() < 6e-4, f"at {wanted}"
    )
    page.picture("typed")
    [move] = page.script(tmp_path)
    assert move["op"] == "move"
    np.testing.assert_allclose(move["by"], wanted - start, atol=1e-3)
    assert move["by"][0] == 0, "what wasn't typed isn't rounded"
    page.tab("Cuboids")
    page.press("all 4: leg")
    page.until(lambda: len(page.numbers(CENTRE)) == 3 and page.value(LENGTHS) == "", "the middle of several")
    middle = page.numbers(CENTRE)
    page.type_number(CENTRE, 0, f"{middle[0] + 0.1:.3f}")
    page.until(lambda: abs(page.numbers(CENTRE)[0] - middle[0] - 0.1) < 1e-3, "all of them moved")
    assert page.script(tmp_path)[-1]["op"] == "move"
    page.tab("Cuboids")
    page.select("seat_surface")
    page.type_number(LENGTHS, 1, "0.2")
    page.click_nothing()
    page.until(lambda: page.selected == [], "nothing selected")
    page.page.keyboard.press("i")
    page.page.get_by_role("dialog").wait_for()
    page.page.keyboard.press("i")
    page.page.get_by_role("dialog").wait_for(state="detached")
    page.press("seat_surface")
    page.until(lambda: page.selected == ["seat_surface"], "the seat selected")
    page.until(lambda: abs(page.numbers(LENGTHS)[1] - 0.2) < 1e-3, "the length that was typed")
    assert "lengths are" not in page.refusals, "0 and 0. were on the way"


def test_looks_views_the_dark_and_other_runs(visit: Visit, editor: Editor) -> None:
    page = visit()
    page.tab("View")
    page.choose("Look", "Clay")
    page.press("Side")
    page.control("Dark", "input").check()
    page.page.keyboard.press("c")
    page.drawn(5)
    page.picture("dark")

    def way() -> np.ndarray:
        seen = camera_of(editor)
        return np.abs(seen.position - seen.look_at)

    page.until(lambda: way()[0] > 10 * way()[1:].max(), "a view from the side")
    assert np.abs(camera_of(editor).look_at).max() < 0.5
    tabs = editor.tabs
    page.choose("Run", "again")
    page.until(lambda: page.value("Run") == "again" and page.value("Mark").startswith("128"), "the other run")
    page.select("seat_surface")
    assert editor.tabs == tabs
