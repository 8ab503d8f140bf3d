"""Shapes as clouds: points uniform by area on the outer surface, in the canonical frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from cagesdf.frames import canonical_similarity
from cagesdf.geometry.meshes import Mesh, sample_surface
from cagesdf.geometry.solid import union
from cagesdf.synthesis.dataset import build
from cagesdf.synthesis.recipe import Recipe
from cagesdf.synthesis.writing import OBJ_DIGITS

FRESH = "drawn_"  # ids of references that were drawn for comparison alone begin so


@dataclass(frozen=True, eq=False)
class Clouds:
    """A set of shapes, each as the same number of points."""

    ids: tuple[str, ...]  # of the shapes
    labels: tuple[str, ...]  # <category>/<family> of the recipe, "" for a shape without one
    points: Float[ndarray, "n p 3"]  # float32, canonical

    def __len__(self) -> int:
        return len(self.ids)


def cloud_of(parts: Sequence[Mesh], count: int, rng: np.random.Generator) -> Float[ndarray, "p 3"]:
    """`count` points uniform on the outer surface of closed parts taken together, float32.

    What lies inside another part is no surface: a generated shape, extracted whole, has none of it.
    """
    points, _ = sample_surface(union(list(parts)), count, rng)
    return points.astype(np.float32)


def recipe_parts(recipe: Recipe, style: Recipe) -> list[Mesh]:
    """The parts of one recipe's cuboids in the style of another of its family, as importing brings them: canonical.

    Vertices are rounded as in written files, which hides what processors' sines and powers differ in.
    """
    meshes = [part.mesh.with_vertices(part.mesh.vertices.round(OBJ_DIGITS)) for part in build(recipe, style)]
    similarity = canonical_similarity(np.concatenate([mesh.vertices for mesh in meshes]), "y")
    return [mesh.with_vertices(similarity.to_canonical(mesh.vertices)) for mesh in meshes]


def label_of(recipe: Recipe) -> str:
    """The class of a recipe's shapes, for the classifier."""
    return f"{recipe.category}/{recipe.family}"
