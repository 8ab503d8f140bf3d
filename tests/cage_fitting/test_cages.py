"""Cages of whole shapes: free cuboids, and those of a program."""

from dataclasses import replace

import numpy as np
import pytest
from manifold3d import Manifold

from cagesdf.cage_fitting.cages import fit_cage
from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.cuboid import Cage
from cagesdf.errors import ShapeRejected
from cagesdf.frames import Similarity, canonical_similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import from_manifold
from cagesdf.shape import Part, Repair, Shape
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.executor import execute
from cagesdf.structure.parsing import parse
from tests.support import toy

FLOOR = 1e-3
# Four equal legs: two declared as one and mirrored twice over.
TABLE = """
Assembly Program_0 {
    bbox = Cuboid(1.0, 1.0, 1.0, True)
    cube0 = Cuboid(1.0, 0.1, 1.0, True)
    cube1 = Cuboid(0.1, 0.9, 0.1, True)
    cube2 = Cuboid(0.1, 0.9, 0.1, True)
    attach(cube0, bbox, 0.5, 1.0, 0.5, 0.5, 1.0, 0.5)
    squeeze(cube1, cube0, bbox, top, 0.1, 0.1)
    squeeze(cube2, cube0, bbox, top, 0.1, 0.9)
    reflect(cube1, X)
    reflect(cube2, X)
}
"""


def box(centre: np.ndarray, size: np.ndarray) -> Mesh:
    return from_manifold(Manifold.cube(size.tolist(), True).translate(centre.tolist()))


def table(thick: float = 0.1, shift: float = 0.0) -> Shape:
    """A table in metres whose last leg is `thick` (program: 0.1), its raw frame moved and scaled by the import."""
    program = parse(TABLE)
    cage = execute(program)
    size = cage.size.copy()
    size[-1, [0, 2]] = thick
    meshes = {
        part_id: box(np.add(centre, [shift, 0, 0]), extent)
        for part_id, centre, extent in zip(cage.part_ids, cage.centre, size)
    }
    similarity = canonical_similarity(np.concatenate([mesh.vertices for mesh in meshes.values()]), "y")
    parts = [
        Part(
            part_id,
            "",
            mesh.with_vertices(similarity.to_canonical(mesh.vertices)),
            Repair("none", 12, 12, 1.0, 1.0, 0, 0, 0.0),
        )
        for part_id, mesh in meshes.items()
    ]
    return Shape("it", "train", tuple(parts), Assembly(program, similarity), similarity)


def fit(shape: Shape, margin: float = 1e-6, seed: int = 0) -> FittedCage:
    return fit_cage(shape, 0.01, FLOOR, margin, 500, np.random.default_rng(seed))


def test_a_cage_has_a_cuboid_a_part_and_its_overshoot() -> None:
    shape = toy.stool("a")
    fitted = fit(shape, margin=0.0)
    assert fitted.assembly is None
    assert fitted.cage.part_ids == tuple(part.part_id for part in shape.parts)
    for i, part in enumerate(shape.parts):
        assert fitted.overshoot[i] == fitted.cage.signed_distance(part.mesh.vertices)[:, i].max()
    assert (fitted.overshoot <= 0).all()
    assert fitted.bounded.all()
    np.testing.assert_array_equal(fitted.outside, 0)
    np.testing.assert_array_equal(fitted.volume_ratio, 1)
    assert np.isnan([fitted.loss, fitted.loss_before]).all()


def test_a_part_beyond_the_margin_rejects_its_shape_by_name() -> None:
    with pytest.raises(ShapeRejected, match=r"shape a, fit_cuboids: part seat .* at most -1 wanted"):
        fit(toy.stool("a"), margin=-1.0)


def test_three_thin_legs_and_a_thick_one_that_share_their_numbers_end_bounded() -> None:
    fitted = fit(table(thick=0.12))
    assert fitted.outside_before[-1] > 0.9
    assert (fitted.overshoot < 1e-6).all()
    assert fitted.bounded.all()
    # The thick leg's partner in the mirror has to be as thick; the others stay as they are.
    np.testing.assert_allclose(fitted.volume_ratio, [1, 1, 1.44, 1, 1], rtol=0.02)
    assert fitted.loss <= fitted.loss_before


def test_the_cuboids_are_those_of_the_fitted_program() -> None:
    fitted = fit(table(thick=0.12, shift=0.3))
    assert fitted.assembly is not None
    np.testing.assert_array_equal(fitted.assembly.cage().vectors(), fitted.cage.vectors())
    assert fitted.cage.part_ids == fitted.assembly.parts()
    assert fitted.assembly.signature() == Assembly(parse(TABLE), fitted.assembly.placement).signature()


def test_parts_that_the_program_does_not_get_to_are_flagged_and_the_shape_kept() -> None:
    """A placement that makes the program a thousandth of the shape: its numbers would have to grow a thousandfold."""
    mesh = box(np.zeros(3), np.ones(3))
    text = "Assembly P {\n bbox = Cuboid(1, 1, 1, True)\n cube0 = Cuboid(1, 1, 1, True)\n}"
    tiny = Similarity(1e-3, np.eye(3), np.zeros(3))
    part = Part("cube0", "", mesh, Repair("none", 12, 12, 1.0, 1.0, 0, 0, 0.0))
    fitted = fit(Shape("it", "train", (part,), Assembly(parse(text), tiny), tiny))
    assert fitted.outside[0] > 0.5
    assert not fitted.bounded[0]
    assert 0.4 < fitted.overshoot[0] < 1


def test_a_program_without_volume_rejects_its_shape() -> None:
    shape = table()
    assert isinstance(shape.structure, Assembly)
    text = TABLE.replace("cube0 = Cuboid(1.0, 0.1, 1.0", "cube0 = Cuboid(1e308, 0.1, 1.0").replace(
        "0.1, 0.1)", "9e9, 0.1)"
    )
    broken = replace(shape, structure=shape.structure.with_program(parse(text)))
    with pytest.raises(ShapeRejected, match="shape it, fit_cuboids: "):
        fit(broken)


def test_equal_seeds_give_equal_cages_and_the_samples_matter_little() -> None:
    shape = table(thick=0.12)
    first, again, other = fit(shape), fit(shape), fit(shape, seed=1)
    assert isinstance(first.cage, Cage)
    np.testing.assert_array_equal(first.cage.vectors(), again.cage.vectors())
    np.testing.assert_allclose(first.cage.vectors(), other.cage.vectors(), atol=0.01)
