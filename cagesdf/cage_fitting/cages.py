"""The cage of a whole shape (§3.2).

A hierarchy's parts are free of each other, so each gets its minimum-volume cuboid. A program's cuboids
are tied together: its parameters are fitted to these, and then grown until the cuboids bound the parts.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.cage_fitting.boxes import straight_cuboid
from cagesdf.cage_fitting.fitted import TOLERANCE, FittedCage
from cagesdf.cage_fitting.programs import bound_program, fit_program, fitting_loss, match_axes
from cagesdf.cuboid import Cage
from cagesdf.errors import ProgramError, ShapeRejected
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import sample_surface
from cagesdf.shape import Shape
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.executor import execute
from cagesdf.structure.program import AssemblyProgram

STAGE = "fit_cuboids"


def fit_cage(
    shape: Shape, slack: float, min_size: float, margin: float, points: int, rng: np.random.Generator
) -> FittedCage:
    """A cuboid for each part of a shape: of its program if it has one, upright or of least volume if not.

    `slack` and `min_size` are `straight_cuboid`'s; `points` are drawn from the surface of each part. Raises
    ShapeRejected if a free cuboid leaves a part more than `margin` (canonical) outside, or if the
    program doesn't execute. Cuboids of a program that can't bound their parts are flagged: `bounded`.
    """
    boxes = Cage.of({part.part_id: straight_cuboid(part.mesh.vertices, slack, min_size) for part in shape.parts})
    samples = np.array([sample_surface(part.mesh, points, rng)[0] for part in shape.parts])
    placed = shape.structure.placed_program()
    if placed is None:
        return _free(shape, boxes, samples, margin)
    try:
        return _tied(shape, boxes, samples, *placed)
    except ProgramError as error:
        raise ShapeRejected(shape.shape_id, STAGE, str(error)) from error


def _free(shape: Shape, boxes: Cage, samples: Float[ndarray, "p n 3"], margin: float) -> FittedCage:
    overshoot = _overshoot(shape, boxes)
    for part, beyond in zip(shape.parts, overshoot):
        if beyond > margin:
            reason = f"part {part.part_id} is {beyond:.2g} outside its cuboid, at most {margin:.2g} wanted"
            raise ShapeRejected(shape.shape_id, STAGE, reason)
    outside = _outside(boxes, samples)
    return FittedCage(boxes, None, overshoot, outside, outside, np.ones(len(boxes)), np.nan, np.nan)


def _tied(
    shape: Shape, boxes: Cage, samples: Float[ndarray, "p n 3"], program: AssemblyProgram, placement: Similarity
) -> FittedCage:
    given = execute(program)
    if (given.size <= 0).any():
        part = given.part_ids[int((given.size <= 0).any(axis=1).argmax())]
        raise ShapeRejected(shape.shape_id, STAGE, f"the program executes to a cuboid {part} without volume")
    local = np.array([placement.to_raw(points) for points in samples])
    targets = match_axes(boxes.transformed(placement.inverse()), given)
    fitted = fit_program(program, targets, local)
    bounding = bound_program(fitted, targets, [placement.to_raw(part.mesh.vertices) for part in shape.parts])

    assembly = Assembly(bounding, placement)
    cage = assembly.cage()
    return FittedCage(
        cage,
        assembly,
        _overshoot(shape, cage),
        _outside(given.transformed(placement), samples),
        _outside(cage, samples),
        cage.size.prod(axis=1) / boxes.size.prod(axis=1),
        fitting_loss(given, targets, local),
        fitting_loss(execute(fitted), targets, local),
    )


def _overshoot(shape: Shape, cage: Cage) -> Float[ndarray, " p"]:
    """A cuboid is convex: the largest distance to it over a part's vertices is the largest over its surface."""
    return np.array([_distance(cage, i, part.mesh.vertices).max() for i, part in enumerate(shape.parts)])


def _outside(cage: Cage, samples: Float[ndarray, "p n 3"]) -> Float[ndarray, " p"]:
    return np.array([(_distance(cage, i, points) > TOLERANCE).mean() for i, points in enumerate(samples)])


def _distance(cage: Cage, i: int, points: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """Signed distance to one cuboid, canonical."""
    return Cage.of({"": cage[cage.part_ids[i]]}).signed_distance(points)[:, 0]
