"""Programs find their parts again: in other trees, out of place, with thin panels and loose meshes."""

import json
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cagesdf.cuboid import CORNER_ORDER, Cage, Cuboid
from cagesdf.errors import InputError, ProgramError, ShapeRejected
from cagesdf.formats.alignment import PADDING, Boxes, Candidate, align, choose
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.formats.partnet import read_candidates
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.importing import import_shape, summary
from cagesdf.io.shapes import read_shapes, write_shapes
from cagesdf.shape import AlignedPart
from cagesdf.structure.executor import execute
from cagesdf.structure.hierarchy import Node
from cagesdf.structure.parsing import parse
from cagesdf.structure.program import AssemblyProgram
from cagesdf.synthesis.dataset import assemble, build, draw, draw_recipes
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import write_shape
from tests.support import toy

REAL = Path(__file__).parents[3] / "shared" / "data" / "partnet" / "3763"
LIMITS: toy.Limits = {"weld": 1e-6, "max_faces": 10**6, "max_parts": 64, "min_thickness": 1e-3}
BLOCK = [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4]]
FACES = np.array([*BLOCK, [1, 5, 7], [1, 7, 3]], np.int32)


def block(centre: tuple[float, ...], size: tuple[float, ...]) -> Mesh:
    """A box as a mesh."""
    return Mesh(CORNER_ORDER * size + np.array(centre), FACES)


def furniture(count: int = 17) -> list[Recipe]:
    """One of each family and more."""
    rng = np.random.default_rng(5)
    return [*draw_recipes("chair", count // 2, 0, rng), *draw_recipes("table", count - count // 2, 0, rng)]


def candidates_of(node: Node) -> list[Candidate]:
    """A drawing's nodes in preorder, each with the parts below it as meshes."""
    leaves = tuple(leaf.node_id for leaf in node.walk() if not leaf.children)
    return [Candidate(node.node_id, node.label, leaves), *(c for child in node.children for c in candidates_of(child))]


def question(recipe: Recipe) -> tuple[AssemblyProgram, list[Candidate], dict[str, Mesh], tuple[str, ...]]:
    """A program, what its leaves may be, and the parts that they are."""
    found = assemble(recipe)
    assert found is not None
    meshes = {part.part_id: part.mesh for part in build(recipe, recipe)}
    return found.program, candidates_of(draw(recipe).structure.tree), meshes, found.part_ids


def given_meshes(parts: tuple[AlignedPart, ...]) -> list[str]:
    return [name for part in parts for name in (*part.objs, *part.leftovers)]


@pytest.mark.parametrize("shift", [0.0, 0.02])
def test_every_leaf_finds_its_part_also_out_of_place_and_with_nodes_in_another_order(shift: float) -> None:
    """Thin rods among them, which are farther off than they are thick."""
    rng = np.random.default_rng(2)
    for recipe in furniture():
        program, candidates, meshes, part_ids = question(recipe)
        # Something far out moves the middle of the box, as meshes that no cuboid bounds do.
        high = max(mesh.vertices[:, 0].max() for mesh in meshes.values())
        meshes["flag"] = block((high + shift, 0.0, 0.0), (2 * shift + 1e-6, 1e-3, 1e-3))
        shuffled = [candidates[i] for i in rng.permutation(len(candidates))]
        found = align(program, shuffled, meshes)
        assert [part.objs for part in found.parts] == [(part_id,) for part_id in part_ids], recipe.family
        assert sorted(given_meshes(found.parts)) == sorted(meshes)
        assert all(0 <= part.iou <= 1 for part in found.parts)


def test_a_leaf_can_stand_for_a_whole_subtree_and_for_what_its_children_leave() -> None:
    """A back with two panels, and a seat that is one of its node's meshes; siblings share none."""
    program = parse(
        "Assembly P {\nbbox = Cuboid(1, 1, 1, True)\na = Cuboid(1, 0.1, 1, True)\nb = Cuboid(1, 0.7, 0.1, True)\n"
        "c = Cuboid(1, 0.2, 1, True)\nattach(a, bbox, 0.5, 0, 0.5, 0.5, 0.2, 0.5)\n"
        "attach(b, bbox, 0.5, 1, 0, 0.5, 1, 0)\nattach(c, bbox, 0.5, 0, 0.5, 0.5, 0, 0.5)\n}"
    )
    meshes = {
        "left": block((-0.25, 0.15, -0.45), (0.5, 0.7, 0.1)),
        "right": block((0.25, 0.15, -0.45), (0.5, 0.7, 0.1)),
        "seat": block((0, -0.25, 0), (1, 0.1, 1)),
        "base": block((0, -0.4, 0), (1, 0.2, 1)),
    }
    candidates = [
        Candidate("0", "chair", tuple(meshes)),
        Candidate("1", "back", ("left", "right")),
        Candidate("2", "panel", ("left",)),
        Candidate("3", "panel", ("right",)),
        Candidate("4", "lower", ("seat", "base")),
        Candidate("5", "base", ("base",)),
        Candidate("-1@4", "other", ("seat",)),
    ]
    found = {part.part_id: (part.label, part.objs) for part in align(program, candidates, meshes).parts}
    assert found == {"a": ("other", ("seat",)), "b": ("back", ("left", "right")), "c": ("base", ("base",))}


def test_left_over_meshes_go_to_the_cuboid_that_holds_them_and_no_mesh_is_lost_or_given_twice() -> None:
    """A screw in the middle of a part belongs to it, or to another part that reaches there."""
    for recipe in furniture(9):
        program, candidates, meshes, part_ids = question(recipe)
        cuboids = draw(recipe).structure.cuboids()
        centres = {f"screw {part_id}": cuboids[part_id].centre for part_id in part_ids[::2]}
        screws = {name: block(tuple(centre), (0.003, 0.003, 0.003)) for name, centre in centres.items()}
        parts = align(program, candidates, meshes | screws).parts
        assert [part.objs for part in parts] == [(part_id,) for part_id in part_ids]
        assert sorted(given_meshes(parts)) == sorted([*meshes, *screws])
        for part in parts:
            cage = Cage.of({"": cuboids[part.objs[0]]})
            # Leaves are a little off their parts.
            assert all(cage.signed_distance(centres[name][None])[0, 0] < 0.03 for name in part.leftovers)


def test_thin_panels_that_miss_their_leaves_are_matched_by_wider_boxes() -> None:
    """Two sheets of 4 mm, 15 mm out of place, the one towards the other's leaf."""
    text = "Assembly P {\nbbox = Cuboid(1, 1, 1, True)\n"
    text += "".join(f"{name} = Cuboid(1, 1, 0.004, True)\n" for name in "ab")
    text += "".join(f"attach({name}, bbox, 0.5, 0.5, 0.5, 0.5, 0.5, {z})\n" for name, z in (("a", 0.5), ("b", 0.55)))
    frame = block((0, 0, 0.499), (1, 1, 0.002)), block((0, 0, -0.499), (1, 1, 0.002))
    meshes = {"x": block((0, 0, 0.015), (1, 1, 0.004)), "y": block((0, 0, 0.065), (1, 1, 0.004))}
    meshes |= dict(zip(("front", "rear"), frame))
    candidates = [Candidate(name, "", (name,)) for name in ("y", "x")]
    parts = align(parse(text + "}"), candidates, meshes).parts
    assert [part.objs for part in parts] == [("x",), ("y",)]


def test_a_mesh_outside_all_cuboids_goes_to_the_nearest() -> None:
    recipe = furniture(2)[0]
    program, candidates, meshes, _ = question(recipe)
    floor = min(mesh.vertices[:, 1].min() for mesh in meshes.values())
    leg = max(meshes, key=lambda name: (-round(meshes[name].vertices[:, 1].min(), 3), meshes[name].vertices.sum()))
    middle = (meshes[leg].vertices.min(axis=0) + meshes[leg].vertices.max(axis=0)) / 2
    castor = block((middle[0], floor - 0.02, middle[2]), (0.01, 0.01, 0.01))
    parts = align(program, candidates, meshes | {"castor": castor}).parts
    assert next(part.objs for part in parts if "castor" in part.leftovers) == (leg,)


def test_the_overlap_is_what_a_fine_lattice_measures() -> None:
    """Of a turned cuboid and the box of two meshes together along its axes."""
    axes = Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
    cage = Cage.of({"a": Cuboid(np.array([0.1, 0.2, 0.0]), axes, np.array([0.5, 0.3, 0.4]))})
    meshes = [block((0, 0, 0), (0.2, 0.3, 0.2)), block((0.1, 0.3, 0.1), (0.1, 0.1, 0.2))]
    owned = np.array([[True, True], [True, False]])
    lattice = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 121)] * 3), axis=-1).reshape(-1, 3)
    found = Boxes.of(cage, meshes, owned).iou(PADDING)
    for c, row in enumerate(owned):
        vertices = cage.to_local(np.concatenate([m.vertices for m, own in zip(meshes, row) if own]), 0)
        in_box = ((lattice >= vertices.min(0) - PADDING) & (lattice <= vertices.max(0) + PADDING)).all(axis=1)
        in_cuboid = (np.abs(lattice) <= cage.size[0] / 2 + PADDING).all(axis=1)
        assert found[0, c] == pytest.approx((in_box & in_cuboid).sum() / (in_box | in_cuboid).sum(), abs=0.02)


def test_the_choice_is_the_best_of_all_that_share_no_mesh() -> None:
    """Against trying everything, on random trees of seven nodes."""
    tree = np.array([[1, 1, 1, 1], [1, 1, 0, 0], [0, 0, 1, 1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    owned = tree.astype(bool)
    for seed in range(60):
        overlap = np.random.default_rng(seed).random((3, 7)).round(2)
        best = 0.0
        for picks in set(permutations([*range(7), -1, -1, -1], 3)):
            taken = [c for c in picks if c >= 0]
            if owned[taken].sum(axis=0).max(initial=0) <= 1:
                best = max(best, sum(overlap[i, c] for i, c in enumerate(picks) if c >= 0))
        chosen = choose(overlap, owned)
        assert owned[[c for c in chosen if c >= 0]].sum(axis=0).max(initial=0) <= 1
        assert sum(overlap[i, c] for i, c in enumerate(chosen) if c >= 0) == pytest.approx(best)


def test_a_leaf_without_a_mesh_is_named() -> None:
    program, candidates, meshes, part_ids = question(furniture(2)[0])
    lost = part_ids[-1]
    del meshes[lost]
    kept = [replace(c, objs=tuple(name for name in c.objs if name != lost)) for c in candidates]
    with pytest.raises(InputError, match=r"leaf Program_\d/cube\d of its program has no mesh"):
        align(program, kept, meshes)
    meshes[part_ids[0]].vertices[0] = np.nan
    with pytest.raises(InputError, match=f"mesh {part_ids[0]} has vertices that are NaN"):
        align(program, kept, meshes)


def test_no_mesh_with_faces_at_all_is_an_error() -> None:
    program, candidates, _, _ = question(furniture(2)[0])
    with pytest.raises(InputError, match="no faces"):
        align(program, candidates, {"1": Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))})


def test_a_shape_with_a_program_is_imported_with_its_leaves_as_parts_and_stored(tmp_path: Path) -> None:
    recipe = furniture(2)[0]
    write_shape(tmp_path / "raw", recipe, 0.0, np.random.default_rng(0))
    raw = read_shape(*list_shapes(tmp_path / "raw", "*"))
    found = assemble(recipe)
    assert found is not None
    labels = draw(recipe).structure.labels()
    assert [part.part_id for part in raw.parts] == list(execute(found.program).part_ids) == list(raw.structure.parts())
    assert [part.label for part in raw.parts] == [labels[part_id] for part_id in found.part_ids]
    shape = import_shape(raw, "y", **LIMITS)
    assert "1 programs, 8 leaves: mean IoU with their parts 0." in summary([shape], [])
    write_shapes(tmp_path, [shape])
    again = read_shapes(tmp_path)
    assert again.alignment(recipe.shape_id) == raw.alignment
    assert again.read(recipe.shape_id).alignment == shape.alignment
    assert again.structure(recipe.shape_id).to_json() == shape.structure.to_json()
    placed = again.structure(recipe.shape_id).placed_program()
    assert placed is not None
    drawn = execute(found.program).transformed(found.placement.then(shape.similarity))
    np.testing.assert_allclose(execute(placed[0]).transformed(placed[1]).vectors(), drawn.vectors(), atol=0.03)


def test_a_broken_program_rejects_the_shape(tmp_path: Path) -> None:
    recipe = furniture(2)[0]
    write_shape(tmp_path, recipe, 0.0, np.random.default_rng(0))
    (source,) = list_shapes(tmp_path, "*")
    assert source.program is not None
    text = source.program.read_text()
    source.program.write_text(text.replace("attach", "attatch", 1))
    with pytest.raises(ShapeRejected, match=r"chair_0000\.txt, line \d+: attatch"):
        read_shape(source)
    source.program.write_text(text + "Assembly Lonely {\nbbox = Cuboid(1, 1, 1, True)\na = Cuboid(1, 1, 1, True)\n}")
    with pytest.raises(ShapeRejected, match="no cuboid is called Lonely"):
        read_shape(source)
    leaves = "".join(f"c{i} = Cuboid(9, 9, 9, True)\n" for i in range(9))
    source.program.write_text(f"Assembly P {{\nbbox = Cuboid(9, 9, 9, True)\n{leaves}}}")
    with pytest.raises(ShapeRejected, match=r"leaf c\d of its program has no mesh"):
        read_shape(source)


def test_part_folders_take_programs_too(tmp_path: Path) -> None:
    """Each file is a candidate; leaves are given the files that lie where they do."""
    (tmp_path / "stool").mkdir()
    for name, mesh in {"b": block((5, 1, 5), (1, 0.2, 1)), "a": block((5, 0.45, 5), (0.2, 0.9, 0.2))}.items():
        lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
        (tmp_path / "stool" / f"{name}.obj").write_text("\n".join(lines))
    (tmp_path / "any_programs").mkdir()
    (tmp_path / "any_programs" / "stool.txt").write_text(
        "Assembly P {\nbbox = Cuboid(1, 1.1, 1, True)\n"
        "seat = Cuboid(1, 0.2, 1, True)\nleg = Cuboid(0.2, 0.9, 0.2, True)\n"
        "attach(seat, bbox, 0.5, 1, 0.5, 0.5, 1, 0.5)\nsqueeze(leg, bbox, seat, bot, 0.5, 0.5)\n}"
    )
    (source,) = list_shapes(tmp_path, "*")
    raw = read_shape(source)
    assert [(part.part_id, part.label) for part in raw.parts] == [("seat", "b"), ("leg", "a")]
    placed = raw.structure.placed_program()
    assert placed is not None
    np.testing.assert_allclose(placed[1].translation, [5, 0.55, 5], atol=1e-12)


def test_alignment_gives_the_same_bytes_again() -> None:
    program, candidates, meshes, _ = question(furniture(4)[3])
    first, again = align(program, candidates, meshes), align(program, candidates, meshes)
    assert first.parts == again.parts
    assert first.placement.to_numbers() == again.placement.to_numbers()


@pytest.mark.skipif(not REAL.is_dir(), reason="needs a real PartNet shape")
def test_a_real_shape_finds_the_nodes_that_a_program_was_written_from() -> None:
    """Its program isn't published: one is written from the boxes of its meshes."""
    candidates, meshes = read_candidates(REAL)
    tree = json.loads((REAL / "result_after_merging.json").read_text())
    assert candidates[0].objs == tuple(tree[0]["objs"])
    leaves = [c for c in candidates if not any(set(d.objs) < set(c.objs) for d in candidates)]
    everything = join(list(meshes.values())).vertices
    centre, extent = (everything.min(0) + everything.max(0)) / 2, np.ptp(everything, axis=0)
    text = f"Assembly P {{\nbbox = Cuboid({', '.join(map(str, extent))}, True)\n"
    declared, attached = "", ""
    distinct = {c.objs: c for c in leaves}
    for i, candidate in enumerate(distinct.values()):
        box = join([meshes[name] for name in candidate.objs]).vertices
        size = np.ptp(box, axis=0).round(2).clip(0.01)
        place = ((box.min(0) + box.max(0)) / 2 - centre) / extent + 0.5
        declared += f"cube{i} = Cuboid({', '.join(map(str, size))}, True)\n"
        attached += f"attach(cube{i}, bbox, 0.5, 0.5, 0.5, {', '.join(map(str, place.round(2)))})\n"
    found = align(parse(f"{text}{declared}{attached}}}"), candidates, meshes)
    assert [part.objs for part in found.parts] == list(distinct)
    assert sorted(given_meshes(found.parts)) == sorted(meshes)


def test_a_program_that_degenerates_is_an_input_error() -> None:
    _, candidates, meshes, _ = question(furniture(2)[0])
    block_text = "Assembly P {\nbbox = Cuboid(1, 1, 1, True)\na = Cuboid(1e308, 1e308, 1e308, False)\n"
    far = product((0, 1), repeat=1)
    lines = "".join(f"attach(a, bbox, {i}, 1e30{8 - i}, 0.5, 0.5, 1e308, 0.5)\n" for (i,) in far)
    with pytest.raises(ProgramError):
        align(parse(block_text + lines + "}"), candidates, meshes)
