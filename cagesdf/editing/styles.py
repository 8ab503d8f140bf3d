"""The styles that operations name, and which part of another shape corresponds to a part."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray

from cagesdf.deformation.matching import correspond, relative_centres
from cagesdf.editing.parts import select
from cagesdf.editing.state import State
from cagesdf.errors import InputError


@dataclass(frozen=True, eq=False)
class Styles:
    """The styles of a run's shapes."""

    shapes: Mapping[str, State]  # at rest, as opened, by shape id
    code_dim: int | None  # numbers of a part's code; None: it is the latent itself, and parts can't be mixed

    @property
    def by_part(self) -> bool:
        """Whether each part has a code of its own, so that parts of several shapes can be mixed."""
        return self.code_dim is not None

    @cached_property
    def signatures(self) -> Mapping[str, str]:
        """By shape id, what tells structures apart up to continuous parameters."""
        return {shape_id: state.structure.signature() for shape_id, state in self.shapes.items()}

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


def ranked(state: State, styles: Styles) -> list[str]:
    """All styles' shape ids, those first that fit a state best.

    First come the shapes of the same structure, then those whose parts have more labels in common with the state's,
    as a share of the parts of both, then the ones whose boxes are most alike.
    """
    signature, labels, box = state.structure.signature(), Counter(state.structure.labels().values()), _box(state)

    def misfit(shape_id: str) -> tuple[bool, float, float]:
        other = styles.shapes[shape_id]
        theirs = Counter(other.structure.labels().values())
        common = sum(number for label, number in (labels & theirs).items() if label)
        sides = float(np.abs(np.log(_box(other) / box)).sum())
        return styles.signatures[shape_id] != signature, -common / (len(state.cage) + len(other.cage)), sides

    return sorted(styles.shapes, key=misfit)


def _box(state: State) -> Float[ndarray, " 3"]:
    """Lengths of the box around a state's cuboids, canonical."""
    return np.ptp(state.cage.corners().reshape(-1, 3), axis=0)


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
