"""Swaps with ground truth: the cuboids of one procedural shape, the style of another (docs/metrics.md).

The truth needs no learning: a recipe's surfaces take a size and a style, and fill a cuboid of that
size. They are made into the cuboids that the network is given. These may be turned about a round part's
axis against the recipe's own, because nothing about such a part says how its cuboid should lie.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation import aligned_cage, deform_shape
from cagesdf.distance import SurfaceDistance
from cagesdf.evaluation.trials import Trial, trial_of
from cagesdf.meshes import Mesh, join
from cagesdf.shape import Shape
from cagesdf.solid import union
from cagesdf.synthesis.dataset import cage_of, fill_cuboids
from cagesdf.synthesis.layout import Style
from cagesdf.synthesis.recipe import Recipe

UNCHANGED = 1e-9  # canonical units: a part whose vertices move less between two styles shows neither


def swaps_of(recipes: Mapping[str, Recipe], sequences: Mapping[str, Sequence]) -> list[tuple[str, str]]:
    """All (cuboids of, style of) of one family and different styles such that no training step showed both together.

    Steps show a shape's style with its own cuboids and, at the end of its sequence, with its target's; other
    shapes may have the same ones. What lies between the two ends isn't the cage of any shape.
    """
    ids = sorted(recipes.keys() & sequences.keys())
    shown = []
    for shape_id in ids:
        shown.append((recipes[shape_id].proportions, recipes[shape_id].style))
        target = recipes.get(sequences[shape_id].target_id or "")
        if target is not None:
            shown.append((target.proportions, recipes[shape_id].style))
    return [
        (a, b)
        for a in ids
        for b in ids
        if recipes[a].family == recipes[b].family
        and recipes[a].style != recipes[b].style
        and (recipes[a].proportions, recipes[b].style) not in shown
    ]


def swap_trial(shape: Shape, rest: Cage, style_of: str, recipes: Mapping[str, Recipe]) -> Trial:
    """The shape that has the cuboids of `shape` at rest and the style of another of its family."""
    recipe = recipes[shape.shape_id]
    own, other = (in_style(shape, rest, recipe, recipes[name].style) for name in (shape.shape_id, style_of))
    trial = trial_of("swap", shape.shape_id, rest, other, name=style_of, style_of=style_of)
    different = np.array([differ(a, b) for a, b in zip(own, other)])
    soup = join(other)
    part = np.repeat(np.arange(len(other)), [len(mesh.faces) for mesh in other])
    # Each face of the union is a piece of a part's face.
    faces = SurfaceDistance(soup).closest(trial.truth.corners().mean(axis=1))[1]
    return replace(trial, changed=different[part[faces]])


def in_style(shape: Shape, rest: Cage, recipe: Recipe, style: Style) -> list[Mesh]:
    """The parts of a shape of this recipe that fill its cuboids in a style, in the cage's order, canonical."""
    nodes, raw = nodes_of(shape), shape.similarity.inverse()
    made = cage_of(recipe)
    cuboids = {
        nodes[part_id]: cuboid.transformed(raw).nearest_to(made[nodes[part_id]].axes)
        for part_id, cuboid in rest.cuboids().items()
    }
    parts = {part.part_id: part.mesh for part in fill_cuboids(recipe, style, cuboids)}
    meshes = [parts[nodes[part_id]] for part_id in rest.part_ids]
    return [mesh.with_vertices(shape.similarity.to_canonical(mesh.vertices)) for mesh in meshes]


def nodes_of(shape: Shape) -> dict[str, str]:
    """By part of a procedural shape, the part of its recipe: a program's leaves have names of their own."""
    return {part.part_id: part.node_id for part in shape.alignment} or {p.part_id: p.part_id for p in shape.parts}


def box_warp(styled: Shape, rest: Cage, shape: Shape, moved: Cage) -> Mesh:
    """A swap without a network: the parts of `styled` deformed from its cage `rest` to that of `shape`, `moved`."""
    partners = {node: part_id for part_id, node in nodes_of(shape).items()}
    pairs = tuple((part_id, partners[node]) for part_id, node in nodes_of(styled).items())
    return union(deform_shape(styled, rest, aligned_cage(rest, moved, pairs)))


def differ(a: Mesh, b: Mesh) -> bool:
    """Whether two surfaces of a part differ, which those that show no style don't."""
    return a.vertices.shape != b.vertices.shape or not np.allclose(a.vertices, b.vertices, rtol=0, atol=UNCHANGED)
