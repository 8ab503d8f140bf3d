"""Swaps with ground truth: the cuboids of one procedural shape, the style of another (docs/metrics.md).

The truth needs no learning: a recipe's surfaces take a size and a style, and fill a cuboid of that
size. They are made into the cuboids that the network is given. These may be turned about a round part's
axis against the recipe's own, because nothing about such a part says how its cuboid should lie.
"""

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from cagesdf.cuboid import Cage, Sequence
from cagesdf.deformation.sequences import aligned_cage, deform_shape, keep_details
from cagesdf.evaluation.trials import MIXES, Trial, trial_of
from cagesdf.geometry.distance import SurfaceDistance
from cagesdf.geometry.meshes import Mesh, join
from cagesdf.shape import Shape
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
        if (recipes[a].category, recipes[a].family) == (recipes[b].category, recipes[b].family)
        and recipes[a].style != recipes[b].style
        and (recipes[a].proportions, recipes[b].style) not in shown
    ]


def swap_trials(
    shape: Shape,
    rest: Cage,
    styled: Shape,
    styled_rest: Cage,
    recipes: Mapping[str, Recipe],
    parts: Container[str] | None = None,
) -> tuple[Trial, Trial]:
    """The cuboids of `shape` at rest with the style of `styled`, of its family: `swap`, then `warp`.

    Their true surfaces are the recipe's, and the parts of `styled` warped from its cuboids, `styled_rest`, into these:
    the right surface, and the one that deformation sequences teach. With `parts`, these alone take the style (a mix).
    """
    recipe = recipes[shape.shape_id]
    original, other = (in_style(shape, rest, recipe, recipes[name].style) for name in (shape.shape_id, styled.shape_id))
    if parts is not None:
        other = [b if part_id in parts else a for part_id, a, b in zip(rest.part_ids, original, other)]
    different = {part_id: differ(a, b) for part_id, a, b in zip(rest.part_ids, original, other)}
    warped, taken = box_warp(styled, styled_rest, shape, rest)
    if parts is not None:
        of_shape = dict(zip(rest.part_ids, original))
        warped = [mesh if part_id in parts else of_shape[part_id] for part_id, mesh in zip(taken, warped)]
    of_part = np.array([different[part_id] for part_id in rest.part_ids])
    of_warped = np.array([different[part_id] for part_id in taken])
    key = {"name": styled.shape_id, "style_of": styled.shape_id}
    swap = _with_changed(trial_of("swap", shape.shape_id, rest, other, **key), other, of_part)
    return swap, _with_changed(trial_of("warp", shape.shape_id, rest, warped, **key), warped, of_warped)


def mix_trials(
    shape: Shape,
    rest: Cage,
    styled: Shape,
    styled_rest: Cage,
    recipes: Mapping[str, Recipe],
    rng: np.random.Generator,
) -> tuple[Trial, ...]:
    """The cuboids of `shape` with the style of `styled` in the parts of one label: one trial for each of MIXES.

    The label is drawn among those that show the style and that not all parts have. Without one there is no trial.
    """
    labels = {part.part_id: part.label for part in shape.parts}
    words = sorted(set(labels.values()))
    for word in rng.permutation(words).tolist() if len(words) > 1 else []:
        parts = [part_id for part_id in rest.part_ids if labels[part_id] == word]
        recipe, warp = swap_trials(shape, rest, styled, styled_rest, recipes, parts)
        if recipe.changed.any():
            pattern, name = "|".join(parts), f"{shape.shape_id}/{styled.shape_id}"
            return tuple(
                replace(trial, kind=kind, trial_id=f"{kind}/{name}", part_id=pattern)
                for kind, trial in zip(MIXES, (recipe, warp, recipe), strict=True)
            )
    return ()


def kept_parts(styled: Shape, styled_rest: Cage, shape: Shape, rest: Cage, parts: Container[str]) -> Iterator[Mesh]:
    """A mix without a network: the parts of `shape`, some of them those of `styled`, whose details keep their size."""
    kept, taken = keep_warp(styled, styled_rest, shape, rest)
    original = {part.part_id: part.mesh for part in shape.parts}
    return (mesh if part_id in parts else original[part_id] for part_id, mesh in zip(taken, kept))


def _with_changed(trial: Trial, meshes: list[Mesh], different: Bool[ndarray, " p"]) -> Trial:
    """The trial, with the faces of its truth that are of parts which are `different`."""
    part = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    # Each face of the union is a piece of a part's face.
    faces = SurfaceDistance(join(meshes)).closest(trial.truth.corners().mean(axis=1))[1]
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


def box_warp(styled: Shape, rest: Cage, shape: Shape, moved: Cage) -> tuple[list[Mesh], list[str]]:
    """A swap without a network: the parts of `styled` deformed from its cage `rest` to that of `shape`, `moved`.

    Second comes for each the part of `shape` whose cuboid it is in.
    """
    return _warped(styled, rest, shape, moved, deform_shape)


def keep_warp(styled: Shape, rest: Cage, shape: Shape, moved: Cage) -> tuple[list[Mesh], list[str]]:
    """The same as `box_warp`, but details keep their size, in the unit of the shapes' files."""
    detail = shape.similarity.scale / styled.similarity.scale
    return _warped(styled, rest, shape, moved, partial(keep_details, detail=detail))


def _warped(
    styled: Shape, rest: Cage, shape: Shape, moved: Cage, deform: Callable[[Shape, Cage, Cage], list[Mesh]]
) -> tuple[list[Mesh], list[str]]:
    partners = {node: part_id for part_id, node in nodes_of(shape).items()}
    pairs = {part_id: partners[node] for part_id, node in nodes_of(styled).items()}
    meshes = deform(styled, rest, aligned_cage(rest, moved, tuple(pairs.items())))
    return meshes, [pairs[part.part_id] for part in styled.parts]


def differ(a: Mesh, b: Mesh) -> bool:
    """Whether two surfaces of a part differ, which those that show no style don't."""
    return a.vertices.shape != b.vertices.shape or not np.allclose(a.vertices, b.vertices, rtol=0, atol=UNCHANGED)
