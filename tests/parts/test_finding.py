"""Parts that are found in whole meshes: laws of the search, what is chosen, and parts that users write down."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cagesdf.cage_fitting.boxes import fit_cuboid
from cagesdf.errors import InputError, NotSolidError, ShapeRejected
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh, is_closed, join, signed_volume
from cagesdf.geometry.solid import SHEET, as_manifold, union
from cagesdf.importing import import_shape, summary, verdict
from cagesdf.io.shapes import read_shapes, write_shapes
from cagesdf.parts.choosing import seams
from cagesdf.parts.components import components
from cagesdf.parts.cutting import CRUMB, box_about, cut, fragments
from cagesdf.parts.finding import as_written, find_parts, parts_as_written
from cagesdf.parts.slots import with_slots
from cagesdf.parts.written import SUFFIX, read_written, written_json
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import PartHierarchy
from tests.support import toy

WELD, THIN = 1e-5, 1e-4
LIMITS: toy.Limits = {"weld": WELD, "max_faces": 10**6, "max_parts": 150, "min_thickness": THIN}
SAME = Similarity(1.0, np.eye(3), np.zeros(3))


def chair_parts() -> dict[str, Mesh]:
    """Boards that overlap, no two of one volume."""
    legs = {
        f"leg_{i}": toy.box([x, -0.4, z], [0.1 + 0.01 * i, 0.62, 0.1])
        for i, (x, z) in enumerate([(-0.4, -0.4), (0.4, -0.4), (-0.4, 0.4), (0.4, 0.4)])
    }
    return {"seat": toy.box([0, -0.05, 0], [1, 0.12, 1]), "back": toy.box([0, 0.4, -0.45], [0.9, 0.9, 0.08]), **legs}


def volumes(meshes: list[Mesh]) -> list[float]:
    return sorted(signed_volume(mesh) for mesh in meshes)


def boxes(meshes: list[Mesh]) -> list[float]:
    return sorted(float(fit_cuboid(mesh.vertices, 0.01, 1e-3).size.prod()) for mesh in meshes)


def found_meshes(mesh: Mesh) -> list[Mesh]:
    return [part.mesh for part in find_parts(mesh, WELD, THIN).parts]


def raw_file(meshes: dict[str, Mesh]) -> RawShape:
    """A shape as one file gives it."""
    parts = tuple(RawPart(name, name, mesh) for name, mesh in meshes.items())
    return RawShape("chair", "train", parts, PartHierarchy.flat(tuple(meshes), tuple(meshes), ""), whole=True)


def test_parts_that_are_joined_into_one_mesh_are_found_again() -> None:
    parts = list(chair_parts().values())
    np.testing.assert_allclose(volumes(found_meshes(join(parts))), volumes(parts), rtol=1e-9)


def test_parts_that_are_united_into_one_solid_are_found_again() -> None:
    parts = list(chair_parts().values())
    whole = union(parts)
    found = find_parts(whole, WELD, THIN)
    assert len(found.components) == 1
    assert len(found.parts) == len(parts)
    assert boxes([part.mesh for part in found.parts]) == pytest.approx(boxes(parts), rel=0.25)
    assert found.boxes < 1.01


def test_a_frame_falls_into_its_four_boards() -> None:
    outer, inner = toy.box([0, 0, 0], [1, 0.8, 0.06]), toy.box([0, 0, 0], [0.8, 0.6, 1])
    frame = toy.from_manifold(as_manifold(outer) - as_manifold(inner))
    found = find_parts(frame, WELD, THIN)
    assert len(found.parts) == 4
    assert found.boxes == pytest.approx(1, abs=2e-3)


def test_a_vessel_with_a_handle_is_a_body_and_a_handle() -> None:
    import manifold3d

    def tube(height: float, outer: float, inner: float) -> manifold3d.Manifold:
        cylinder = manifold3d.Manifold.cylinder
        return cylinder(height, outer, outer, 48) - cylinder(height, inner, inner, 48).translate([0, 0, 0.05])

    ring = manifold3d.Manifold.revolve(manifold3d.CrossSection.circle(0.04, 16).translate([0.25, 0]), 32)
    handle = ring.rotate([90, 0, 0]).translate([0.5, 0, 0.5]) - manifold3d.Manifold.cylinder(1, 0.45, 0.45, 48)
    found = find_parts(toy.from_manifold(tube(1, 0.5, 0.45) + handle), WELD, THIN)
    sizes = [fit_cuboid(part.mesh.vertices, 0.01, 1e-3).size for part in found.parts]
    assert len(sizes) == 2
    np.testing.assert_allclose(np.sort(sizes[0]), [1, 1, 1], rtol=0.05)


def test_a_tube_that_is_open_at_both_ends_has_one_cuboid() -> None:
    import manifold3d

    cylinder = manifold3d.Manifold.cylinder
    tube = cylinder(1, 0.5, 0.4, 32, center=True) - cylinder(2, 0.35, 0.35, 32, center=True)
    assert len(fragments(tube, 0, 0.02 * tube.volume())) == 1


@pytest.mark.parametrize("joined", [join, union])
def test_the_parts_together_are_the_shape_and_each_is_closed(joined) -> None:
    whole = joined(list(chair_parts().values()))
    found = found_meshes(whole)
    assert all(is_closed(mesh) and signed_volume(mesh) > 0 for mesh in found)
    assert signed_volume(union(found)) == pytest.approx(signed_volume(union([*chair_parts().values()])), rel=1e-4)


@pytest.mark.parametrize(
    ("turning", "scale"), [([0.3, 0.5, -0.2], 0.01), ([0.0, 0.7, 0.0], 1.0), ([1.2, 0.0, 0.4], 1000.0)]
)
def test_a_shape_that_is_turned_moved_and_scaled_has_the_same_parts(turning, scale) -> None:
    whole = union(list(chair_parts().values()))
    turned = scale * whole.vertices @ Rotation.from_rotvec(turning).as_matrix().T + scale * np.array([3.0, -2.0, 5.0])

    def sizes(mesh: Mesh, unit: float) -> np.ndarray:
        shape = import_shape(raw_file({"all": mesh}), "y", **LIMITS, parts="auto")
        return np.array(volumes([part.mesh for part in shape.parts])) / (shape.similarity.scale * unit) ** 3

    np.testing.assert_allclose(sizes(whole.with_vertices(turned), scale), sizes(whole, 1), rtol=5e-3)


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**31))
def test_every_vertex_lies_in_the_cuboid_of_a_part_whatever_the_shape(seed) -> None:
    rng = np.random.default_rng(seed)
    solids = [toy.box(rng.uniform(-1, 1, 3), rng.uniform(0.05, 1, 3)) for _ in range(4)]
    solids.append(toy.ball(rng.uniform(-1, 1, 3), rng.uniform(0.1, 0.6), 12))
    start, end = rng.uniform(-1, 1, (2, 3))
    solids.append(toy.rod(start, end, 0.1))
    mesh = union(solids) if seed % 2 else join(solids)
    cuboids = [fit_cuboid(part.vertices, 0.01, 1e-3) for part in found_meshes(mesh)]
    outside = [(np.abs((mesh.vertices - c.centre) @ c.axes.T) - c.size / 2).max(axis=1) for c in cuboids]
    assert np.min(outside, axis=0).max() <= 2e-5, "but for vertices that were welded, all are covered"


def test_the_same_mesh_has_the_same_parts_to_the_last_bit() -> None:
    whole = union([*chair_parts().values(), toy.ball([0.2, 0.2, 0.1], 0.2)])
    first, second = found_meshes(whole), found_meshes(whole)
    assert [mesh.vertices.tobytes() for mesh in first] == [mesh.vertices.tobytes() for mesh in second]


def test_box_about_is_hardly_larger_than_the_least_cuboid() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn = Rotation.random(random_state=rng).as_matrix()
        points = (rng.uniform(-1, 1, (100, 3)) * [1, 0.5, 0.2]) @ turn.T
        volume, axes = box_about(points, np.eye(3))
        least = fit_cuboid(points, 0.0, 1e-6).size.prod()
        assert least * (1 - 1e-9) <= volume <= 1.4 * least
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)


def test_a_cut_keeps_the_volume_but_for_crumbs_and_its_sides_are_where_they_say() -> None:
    solid = as_manifold(union(list(chair_parts().values())))
    pieces = cut(solid, (0.0, 1.0, 0.0, -0.2))
    assert len(pieces) == 5
    assert sum(piece.volume() for piece, _ in pieces) == pytest.approx(solid.volume(), rel=5 * CRUMB)
    for piece, (x, y, z, d) in pieces:
        assert (toy.from_manifold(piece).vertices @ [x, y, z]).max() <= d + 1e-9


def test_a_solid_that_fills_its_cuboid_is_not_cut() -> None:
    assert len(fragments(as_manifold(toy.box([0, 0, 0], [1, 2, 3])), 0, 0.1)) == 1
    assert len(fragments(as_manifold(toy.rod([0, 0, 0], [0, 0, 1], 0.1, 1.0)), 0, 0.001)) == 1


def test_what_is_nearly_convex_and_round_vessels_are_one_part_and_what_is_bent_is_not() -> None:
    import manifold3d

    ball = manifold3d.Manifold.sphere(0.5, 48)
    bowl = ball - manifold3d.Manifold.sphere(0.42, 48) - as_manifold(toy.box([0, 0, 0.45], [1, 1, 0.3]))
    wedge = manifold3d.Manifold.hull_points(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]))
    for solid in (ball, bowl, wedge):
        assert len(fragments(solid, 0, 0.02 * solid.volume())) == 1
    bent = as_manifold(union([toy.box([0, 0, 0], [1, 0.2, 0.2]), toy.box([0.4, 0.5, 0], [0.2, 1, 0.2])]))
    assert len(fragments(bent, 0, 0.02 * bent.volume())) == 2


def test_a_component_within_another_and_a_face_that_came_twice_make_no_component() -> None:
    outside, inside = toy.box([0, 0, 0], [1, 1, 1]), toy.ball([0, 0, 0], 0.3)
    doubled = Mesh(outside.vertices, np.concatenate([outside.faces, outside.faces[:, ::-1]]))
    assert [c.solid.volume() for c in components(join([doubled, inside]), WELD, THIN)] == pytest.approx([1])


def test_sides_of_a_box_in_several_groups_are_one_component_and_sheets_get_a_thickness() -> None:
    box = toy.box([0, 0, 0], [1, 1, 1])
    sides = [Mesh(box.vertices, box.faces[i::3]) for i in range(3)]
    sheet = Mesh(np.array([[2.0, 0, 0], [3, 0, 0], [3, 1, 0], [2, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    found = components(join([*sides, sheet]), WELD, THIN)
    assert [c.solid.volume() for c in found] == pytest.approx([1, SHEET], rel=0.01)
    assert [c.repair.plates for c in found] == [0, 1]


def test_nothing_but_a_point_makes_no_parts() -> None:
    with pytest.raises(NotSolidError):
        find_parts(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)), WELD, THIN)


# Labels across a collection.


def test_parts_in_one_place_have_one_label_in_all_shapes_and_repeated_parts_share_it() -> None:
    tall = {name: mesh.with_vertices(mesh.vertices * [1, 1.2, 0.9]) for name, mesh in chair_parts().items()}
    stool = {name: mesh for name, mesh in chair_parts().items() if name != "back"}
    imported = [
        import_shape(raw_file({"all": join(list(parts.values()))}), "y", **LIMITS, parts="auto")
        for parts in (chair_parts(), tall, stool)
    ]
    given = import_shape(raw_file(chair_parts()), "y", **LIMITS)
    first, second, third, same = with_slots([*imported, given])
    assert same is given
    labels = [sorted(part.label for part in shape.parts) for shape in (first, second, third)]
    assert labels[0] == labels[1]
    assert [len(set(own)) for own in labels] == [3, 3, 2]
    assert first.structure.signature() == second.structure.signature() != third.structure.signature()
    assert all(shape.structure.labels() == {p.part_id: p.label for p in shape.parts} for shape in (first, second))


def test_a_label_that_a_user_wrote_is_kept() -> None:
    shape = import_shape(raw_file({"all": join(list(chair_parts().values()))}), "y", **LIMITS, parts="auto")
    named = replace(shape, parts=(replace(shape.parts[0], label="Sitz"), *shape.parts[1:]))
    [labelled] = with_slots([named])
    assert labelled.parts[0].label == "Sitz"
    assert all(part.label for part in labelled.parts)


# Given, found or written.


def test_groups_that_are_parts_are_kept_and_groups_by_material_are_not() -> None:
    parts = chair_parts()
    kept = import_shape(raw_file(parts), "y", **LIMITS, parts="auto")
    assert [part.part_id for part in kept.parts] == list(parts)
    assert (kept.origin.parts, kept.origin.reason) == ("given", "cuboids bound the 6 groups of its file well")
    materials = {"wood": join([mesh for name, mesh in parts.items() if name != "seat"]), "cloth": parts["seat"]}
    found = import_shape(raw_file(materials), "y", **LIMITS, parts="auto")
    assert (found.origin.parts, len(found.parts)) == ("found", 6)
    assert "cuboids of its 2 groups hold" in found.origin.reason
    assert "parts found, 6: " in verdict(found)
    assert "parts: 1 given, 1 found" in summary([kept, found], [])
    assert import_shape(raw_file(materials), "y", **LIMITS).origin.parts == "given"
    forced = import_shape(raw_file({"all": join([*parts.values()])}), "y", **LIMITS, parts="found")
    assert len(forced.parts) == 6


CORNERS = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [2, 3, 7, 6], [1, 2, 6, 5], [0, 4, 7, 3]]  # of a box's faces


def obj_of_boxes(groups: dict[str, list[Mesh]], quads: bool, backwards: bool) -> str:
    """An OBJ file of boxes in groups: faces of four corners or three, corners counted from the first or the last."""
    lines, known = ["mtllib none.mtl"], 0
    for name, members in groups.items():
        lines += [f"g {name}", f"usemtl {name}"]
        for box in members:
            low, high = box.vertices.min(axis=0), box.vertices.max(axis=0)
            x, y, z = np.stack([low, high], axis=1).tolist()
            bottom = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]
            lines += [f"v {a!r} {b!r} {c!r}" for c in z for a, b in bottom]
            for face in CORNERS:
                corners = [face] if quads else [face[:3], [face[0], *face[2:]]]
                lines += ["f " + " ".join(str(i - 8 if backwards else known + i + 1) for i in row) for row in corners]
            known += 8
    return "\n".join(lines)


@pytest.mark.parametrize("quads", [True, False])
@pytest.mark.parametrize("backwards", [True, False])
def test_groups_of_an_obj_file_that_are_materials_are_taken_apart_and_parts_are_kept(
    tmp_path: Path, quads: bool, backwards: bool
) -> None:
    parts = chair_parts()
    materials = {"wood": [mesh for name, mesh in parts.items() if name != "seat"], "cloth": [parts["seat"]]}
    for name, groups in (("parts", {name: [mesh] for name, mesh in parts.items()}), ("materials", materials)):
        (tmp_path / f"{name}.obj").write_text(obj_of_boxes(groups, quads, backwards))
    shapes = {s.shape_id: import_shape(read_shape(s), "y", **LIMITS, parts="auto") for s in list_shapes(tmp_path, "*")}
    assert [part.part_id for part in shapes["parts"].parts] == list(parts)
    assert shapes["materials"].origin.parts == "found"
    assert all(part.repair.method == "none" for part in shapes["parts"].parts), "boxes come closed and outward"
    for shape in shapes.values():
        sizes = np.array(volumes([part.mesh for part in shape.parts])) / shape.similarity.scale**3
        np.testing.assert_allclose(sizes, volumes(list(parts.values())), rtol=1e-9)


def test_groups_that_share_open_edges_are_materials() -> None:
    box = toy.box([0, 0, 0], [1, 1, 1])
    heights = box.corners()[..., 1].mean(axis=1)
    halves = [Mesh(box.vertices, box.faces[heights * side > -0.1]) for side in (1, -1)]
    assert seams(halves, WELD) > 0.2
    assert seams([toy.box([0, 0, 0], [1, 1, 1]), toy.box([1, 0, 0], [1, 1, 1])], WELD) == 0


def test_a_folder_of_part_meshes_is_taken_at_its_word() -> None:
    raw = replace(raw_file({"all": join(list(chair_parts().values()))}), whole=False)
    assert len(import_shape(raw, "y", **LIMITS, parts="auto").parts) == 1


def test_where_parts_come_from_is_kept_in_the_artefact(tmp_path: Path) -> None:
    whole = {"all": join(list(chair_parts().values()))}
    given = replace(import_shape(raw_file(whole), "y", **LIMITS), shape_id="a")
    write_shapes(tmp_path, [given])
    assert not (tmp_path / "origins.parquet").exists()
    found = replace(import_shape(raw_file(whole), "y", **LIMITS, parts="auto"), shape_id="b")
    write_shapes(tmp_path, [given, found])
    assert [shape.origin for shape in read_shapes(tmp_path)] == [given.origin, found.origin]


def written_file(folder: Path) -> Path:
    """A mesh, and its found parts beside it, in another unit and place."""
    mesh = union(list(chair_parts().values()))
    placement = Similarity(0.5, Rotation.from_rotvec([0.2, 0.3, 0.4]).as_matrix(), np.array([1.0, 2, 3]))
    raw = placement.to_raw(mesh.vertices)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in raw.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()]
    (folder / "chair.obj").write_text("\n".join(lines))
    path = folder / f"chair{SUFFIX}"
    path.write_text(written_json(as_written(find_parts(mesh, WELD, THIN), placement)))
    return path


def test_parts_that_were_written_down_come_back_and_are_preferred(tmp_path: Path) -> None:
    path = written_file(tmp_path)
    content = json.loads(path.read_text())
    content["parts"][0] |= {"name": "Sitz", "label": "seat"}
    merged = content["parts"].pop()
    content["parts"][-1]["pieces"] += merged["pieces"]
    path.write_text(json.dumps(content))
    [source] = list_shapes(tmp_path, "*")
    shape = import_shape(read_shape(source), "y", **LIMITS)
    assert (shape.origin.parts, len(shape.parts)) == ("written", 5)
    assert (shape.parts[0].part_id, shape.parts[0].label) == ("Sitz", "seat")
    scale = shape.similarity.scale * 2
    whole = signed_volume(union(list(chair_parts().values())))
    assert signed_volume(union([part.mesh for part in shape.parts])) == pytest.approx(whole * scale**3, rel=1e-3)


def test_written_parts_are_those_that_were_found() -> None:
    mesh = union(list(chair_parts().values()))
    found = find_parts(mesh, WELD, THIN)
    again = parts_as_written(mesh, as_written(found, SAME), SAME, WELD, THIN)
    assert [part.name for part in again.parts] == [part.name for part in found.parts]
    for part, same in zip(found.parts, again.parts):
        assert signed_volume(part.mesh) == pytest.approx(signed_volume(same.mesh), rel=1e-6)


def test_parts_of_another_mesh_and_parts_that_leave_something_out_are_refused(tmp_path: Path) -> None:
    path = written_file(tmp_path)
    content = json.loads(path.read_text())
    wrong = [
        (content | {"components": 2}, "were written for 2 components, the shape has 1"),
        (content | {"parts": content["parts"][1:]}, "leave out"),
    ]
    for changed, message in wrong:
        path.write_text(json.dumps(changed))
        [source] = list_shapes(tmp_path, "*")
        with pytest.raises(ShapeRejected, match=message):
            import_shape(read_shape(source), "y", **LIMITS)


PIECE: dict[str, object] = {"component": 0, "planes": [], "inside": [0, 0, 0]}
CHANGES: list[tuple[dict[str, object], str]] = [
    ({"component": True}, "as component, got True"),
    ({"component": 1.5}, "as component, got 1.5"),
    ({"planes": [[0, 0, 0, 1]]}, "normal of length 1"),
    ({"planes": [[0, 1, 0]]}, "wanted 4 numbers"),
    ({"planes": "x"}, "list of at most 1,000 planes"),
    ({"inside": [0, 0]}, "wanted 3 numbers"),
    ({"inside": [0, 0, float("nan")]}, "wanted finite numbers"),
    ({"inside": [0, 0, 10**400]}, "wanted finite numbers"),
]
HOSTILE = {
    "[": "is no JSON",
    "[" * 100_000: "is no JSON",
    "[]": "wanted an object",
    "{}": "wanted a list of 1 to 1,000 parts",
    '{"parts": [1]}': "part 0: wanted an object",
    json.dumps({"components": 1, "parts": [{"name": "", "pieces": [PIECE]}]}): "part 0: wanted a name",
    json.dumps({"components": 1, "parts": [{"name": "a\nb", "pieces": [PIECE]}]}): "part 0: wanted a name",
    json.dumps({"components": 1, "parts": [{"name": "a", "label": 3, "pieces": [PIECE]}]}): "wanted a label",
    json.dumps({"components": 1, "parts": [{"name": "a", "pieces": []}]}): "wanted a list of 1 to 10,000 pieces",
    json.dumps({"components": -1, "parts": [{"name": "a", "pieces": [PIECE]}]}): "as components, got -1",
    json.dumps({"components": 1, "parts": 2 * [{"name": "a", "pieces": [PIECE]}]}): "two parts are called 'a'",
    **{
        json.dumps({"components": 1, "parts": [{"name": "a", "pieces": [PIECE | change]}]}): message
        for change, message in CHANGES
    },
}


@pytest.mark.parametrize(("text", "message"), HOSTILE.items(), ids=range(len(HOSTILE)))
def test_a_file_of_parts_that_is_wrong_is_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / f"a{SUFFIX}"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_written(path)
    assert str(path) in str(caught.value)


def test_parts_of_no_shape_are_noted(tmp_path: Path) -> None:
    written_file(tmp_path)
    (tmp_path / f"other{SUFFIX}").write_text("{}")
    assert list_shapes(tmp_path, "*").notes == (f"parts of no shape, as none is called like these: other{SUFFIX}",)
