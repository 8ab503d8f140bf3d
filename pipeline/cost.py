"""Costs of stages, for `cagesdf plan`. Each declares its cost in its own file, as COST."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

Sections = Mapping[str, Any]  # of a parameter file, by name, as `params.check` returns them


@dataclass(frozen=True)
class Cost:
    """How a stage's time and output grow, and how little of it is enough to measure them."""

    unit: str  # what its time is in proportion to, in the plural
    items: Callable[[Sections, str], int]  # how many a category has, by the parameters and the arm: "" for none
    small: Mapping[str, Any] = field(default_factory=dict)  # changes of its parameters while it is measured
    # From its parameters to two others: the difference between their times is measured, so that all else drops out.
    difference: Callable[[Any], tuple[Any, Any]] | None = None
    grows: bool = True  # whether its output does, with the items
    held: Callable[[Sections, int], int] = lambda sections, size: 0  # bytes of memory besides, of an output of `size`


@dataclass(frozen=True)
class Counts:
    """How much there is to do in one category; exact but for `points`, which each cuboid's minimum adds to.

    How many points parts have follows from their surfaces: they are not counted here, but in what is measured.
    """

    shapes: int  # training and validation
    sequences: int  # training shapes
    deformed: int  # training steps of all sequences
    points: int  # asked for: near the surface and in the cube, of all deformed shapes
    surfaces: int  # to extract where held-out steps have a latent, and the references
    trials: int  # edits

    @staticmethod
    def of(sections: Sections) -> "Counts":
        """The counts that a run's parameters ask for."""
        drawn, deform, sample, extract, trials = (
            sections[name]
            for name in ("synthesize", "deform_sequences", "sample_points", "extract_meshes", "make_trials")
        )
        held_out = len(set(deform.held_out))
        deformed = drawn.train * (deform.steps - held_out)
        return Counts(
            drawn.train + drawn.val,
            drawn.train,
            deformed,
            deformed * (sample.near + sample.uniform),
            min(extract.sources, drawn.train) + min(extract.held_out, drawn.train) * held_out,
            2 * trials.swaps
            + 3 * trials.mixes
            + min(trials.shapes, drawn.train) * (2 + trials.local + len(trials.beyond)),
        )


def shapes(sections: Sections, arm: str) -> int:
    """Training and validation shapes."""
    return Counts.of(sections).shapes


def sequences(sections: Sections, arm: str) -> int:
    """Training shapes."""
    return Counts.of(sections).sequences


def surfaces(sections: Sections, arm: str) -> int:
    """Surfaces of source shapes, and of held-out steps where an arm has one latent for a whole sequence."""
    if arm and sections[f"arms.{arm}"].latents == "deformed":
        return min(sections["extract_meshes"].sources, Counts.of(sections).sequences)
    return Counts.of(sections).surfaces


def trials(sections: Sections, arm: str) -> int:
    """Edits with a true outcome."""
    return Counts.of(sections).trials


def references(sections: Sections, arm: str) -> int:
    """Clouds of shapes: training shapes are compared with as well."""
    return Counts.of(sections).shapes + sections["make_clouds"].drawn
