"""The styles that operations name, and which part of another shape corresponds to a part."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from cagesdf.editing.parts import select
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.matching import correspond, relative_centres


@dataclass(frozen=True, eq=False)
class Styles:
    """The styles of a run's shapes."""

    shapes: Mapping[str, State]  # at rest, as opened, by shape id
    code_dim: int | None  # numbers of a part's code; None: it is the latent itself, and parts can't be mixed

    @property
    def by_part(self) -> bool:
        """Whether each part has a code of its own, so that parts of several shapes can be mixed."""
        return self.code_dim is not None

    def named(self, shape_id: str) -> State:
        """The shape that has a style. Raises InputError if there is none."""
        if shape_id not in self.shapes:
            near = get_close_matches(shape_id, self.shapes, n=3, cutoff=0.5) or sorted(self.shapes)[:3]
            raise InputError(
                f"style_of {shape_id!r}: none of the {len(self.shapes)} styles; did you mean {', '.join(near)}?"
            )
        return self.shapes[shape_id]

    def latents(self) -> Float32[ndarray, "n d"]:
        """The latents of all shapes, in the order of `shapes`."""
        return np.stack([state.latent for state in self.shapes.values()])


def corresponding(state: State, other: State, pattern: str | None) -> dict[str, str]:
    """By part of `state`, the corresponding part of `other`; a part without one is left out.

    Where the structures are equal, parts correspond as in deformation sequences (`matching.correspond`). Otherwise, and
    where that part is not called `pattern`, it is the nearest of those called `pattern`, or, without a pattern, of
    those with the same label; each cage's bounding box being mapped to a unit cube. So what corresponds to a part
    doesn't depend on what else is mixed. Raises InputError as `select` does for a pattern that finds none of them.
    """
    called = None if pattern is None else select(other.structure, pattern)
    ours, theirs = state.structure.labels(), other.structure.labels()
    equal = state.structure.signature() == other.structure.signature()
    seen = state.seen_by_part()
    pairs = dict(correspond(state.structure, seen, other.structure, other.cage)) if equal else {}
    centres = dict(zip(other.cage.part_ids, relative_centres(other.cage)))
    partners = {}
    for part, centre in zip(seen.part_ids, relative_centres(seen)):
        partner = pairs.get(part)
        if partner is None or (called is not None and partner not in called):
            same = [name for name in other.cage.part_ids if ours[part] and theirs[name] == ours[part]]
            candidates = same if called is None else called
            distances = {name: float(np.linalg.norm(centres[name] - centre)) for name in candidates}
            partner = min(distances, key=lambda name: distances[name], default=None)
        if partner is not None:
            partners[part] = partner
    return partners
