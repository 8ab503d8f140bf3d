"""Edits whose true outcome is known: what the arms are tried on beyond their own sequences (docs/metrics.md)."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.matching import touching
from cagesdf.deformation.sequences import SMALLEST, deform_shape, interpolated_cage
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import union
from cagesdf.shape import Shape

SWAPS = ("swap", "warp")  # kinds with another shape's style, by truth: the recipe's, the box-warp's
# Kinds with another shape's style in some parts. The third has the recipe's truth, too, and details keep their size.
MIXES = ("mix", "mix_warp", "mix_keep")
STYLED = (*SWAPS, *MIXES)
KINDS = ("rest", "local", "beyond", "bent", *STYLED)


@dataclass(frozen=True, eq=False)
class Trial:
    """One edit, and the surface that it should give."""

    trial_id: str  # unique in its category, its kind first
    kind: str  # one of KINDS
    shape_id: str  # whose cuboids these are, or were before they moved
    style_of: str  # whose latent the network is given
    part_id: str  # the one whose cuboid was edited, of mixes those that take the style, joined by |; "" for the others
    cage: Cage  # what the network is given, canonical
    truth: Mesh  # closed, outward, canonical
    changed: Bool[ndarray, " f"]  # faces of the truth that belong to parts whose style changed; all where none did


def trial_of(
    kind: str, shape_id: str, cage: Cage, meshes: list[Mesh], part_id: str = "", name: str = "", style_of: str = ""
) -> Trial:
    """A trial whose truth is the union of closed parts, in the latent of `style_of`, or the shape's own."""
    truth = union(meshes)
    trial_id = "/".join(word for word in (kind, shape_id, name) if word)
    everywhere = np.ones(len(truth.faces), dtype=bool)
    return Trial(trial_id, kind, shape_id, style_of or shape_id, part_id, cage, truth, everywhere)


def rest_trial(shape: Shape, rest: Cage) -> Trial:
    """No edit at all: what the others are compared with."""
    return trial_of("rest", shape.shape_id, rest, [part.mesh for part in shape.parts])


def local_trials(
    shape: Shape,
    rest: Cage,
    count: int,
    resize: tuple[float, float],
    move: tuple[float, float],
    rng: np.random.Generator,
) -> Iterator[Trial]:
    """`count` edits of single cuboids: resized along one of its axes, and moved along one, in turns.

    Factors and lengths (canonical) are uniform in `resize` and `move`. Drawn are cuboids that some
    other doesn't touch; a shape without any has no such trial. The truth is the trilinear deformation.
    """
    free = np.flatnonzero((~touching(rest)).sum(axis=1) > 1)
    for number in range(count if len(free) else 0):
        part, axis = int(rng.choice(free)), int(rng.integers(3))
        if number % 2 == 0:
            size = rest.size.copy()
            size[part, axis] *= rng.uniform(*resize)
            edited = replace(rest, size=size)
        else:
            centre = rest.centre.copy()
            centre[part] += rng.choice([-1, 1]) * rng.uniform(*move) * rest.axes[part, axis]
            edited = replace(rest, centre=centre)
        part_id = rest.part_ids[part]
        yield trial_of("local", shape.shape_id, edited, deform_shape(shape, rest, edited), part_id, f"{number}")


def beyond_trials(shape: Shape, sequence: Sequence, places: tuple[float, ...]) -> tuple[list[Trial], int]:
    """The sequence's line through its first and last cage, followed to `places` beyond [0, 1].

    The truth is the trilinear deformation. Second comes how many places were left out because a cuboid
    would be thinner than `sequences.SMALLEST` there, or inside out.
    """
    rest = sequence.cages[0]
    cages = {t: interpolated_cage(rest, sequence.cages[-1], t) for t in places}
    trials = [
        trial_of("beyond", shape.shape_id, cage, deform_shape(shape, rest, cage), name=f"{t:g}")
        for t, cage in cages.items()
        if cage.size.min() >= SMALLEST
    ]
    return trials, len(places) - len(trials)


def bent_trial(shape: Shape, sequence: Sequence, reach: float) -> Trial:
    """Towards the sequence's last cage with shared vertices, so that no part's deformation is affine.

    The network is given the cuboids refitted to the deformed parts, and nothing else of it.
    """
    rest, moved = sequence.cages[0], sequence.cages[-1]
    before = [part.mesh for part in shape.parts]
    after = [mesh.with_vertices(blend(mesh.vertices, rest, moved, reach)) for mesh in before]
    return trial_of("bent", shape.shape_id, refitted(rest, moved, before, after), after)


def blend(vertices: Float[ndarray, "v 3"], rest: Cage, moved: Cage, reach: float) -> Float[ndarray, "v 3"]:
    """Vertices inside some cuboid after each has gone to a weighted mean of where the cuboids around it take it.

    A cuboid's weight is 1 inside it and (1 − d/reach)² at a distance d < `reach` from it, canonical. With
    a reach that tends to 0 this is `sequences.deform_vertices`.
    """
    weights = (1 - rest.signed_distance(vertices).clip(0) / reach).clip(0) ** 2
    total = np.zeros_like(vertices)
    for i in np.flatnonzero(weights.any(axis=0)).tolist():
        near = weights[:, i] > 0
        total[near] += weights[near, i, None] * moved.from_unit(rest.to_unit(vertices[near], i), i)
    return total / weights.sum(axis=1)[:, None]


def refitted(rest: Cage, moved: Cage, before: list[Mesh], after: list[Mesh]) -> Cage:
    """Cuboids along the axes of `moved` that lie around the parts `after` as those of `rest` do around `before`.

    A cuboid that leaves its part some room, as a program's may, keeps that room, as a share of the part's
    extent. So parts that were moved by the affine maps from `rest` to `moved` give `moved`.
    """
    centre, size = moved.centre.copy(), moved.size.copy()
    for i, (old, new) in enumerate(zip(before, after)):
        ends = [frame(mesh.vertices, i) for frame, mesh in ((rest.to_unit, old), (moved.to_unit, new))]
        (low, high), (new_low, new_high) = [(points.min(axis=0), points.max(axis=0)) for points in ends]
        stretch = (new_high - new_low) / (high - low)
        centre[i] = moved.from_unit(((new_low + new_high) / 2 - stretch * (low + high) / 2)[None], i)[0]
        size[i] = moved.size[i] * stretch
    return replace(moved, centre=centre, size=size)
