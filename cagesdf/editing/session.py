"""A trained run, opened for editing: from shapes to states, from states to surfaces."""

from collections.abc import Mapping
from difflib import get_close_matches
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from cagesdf.cuboid import Cage
from cagesdf.editing.operations import edited
from cagesdf.editing.parts import part_names
from cagesdf.editing.script import Script
from cagesdf.editing.state import History, State
from cagesdf.editing.styles import Styles
from cagesdf.errors import InputError
from cagesdf.exported import ExportedShape
from cagesdf.extraction import (
    LOOSE,
    METHODS,
    SYMMETRIES,
    USUAL,
    CageField,
    Each,
    Extraction,
    Fineness,
    LiveSurface,
    field_of,
)
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.geometry.solid import CUBE_FACES
from cagesdf.models.codes import part_codes
from cagesdf.run import Run
from cagesdf.structure.base import Structure


class Session:
    """The shapes of a run, as commands and editors open, edit and extract them."""

    def __init__(self, run: Run) -> None:
        self.run = run

    @cached_property
    def styles(self) -> Styles:
        """The styles of all shapes, sorted by id."""
        shapes = {shape_id: self.opened(shape_id) for shape_id in sorted(self.run.sequences)}
        return Styles(shapes, self.run.decoder.code_dim)

    def opened(self, shape_id: str, step: int = 0) -> State:
        """One step of a shape's sequence, as it was trained on. Raises InputError if there is none."""
        known = sorted(self.run.sequences)
        if shape_id not in known:
            near = get_close_matches(shape_id, known, n=3, cutoff=0.5) or known[:3]
            raise InputError(
                f"the run has no shape {shape_id!r} among its {len(known)}; did you mean {', '.join(near)}?"
            )
        steps = self.run.steps(shape_id)
        if step not in steps:
            raise InputError(f"--step {step}: {shape_id} has the steps {', '.join(map(str, steps))}")
        return State.opened(
            self.run.sequences[shape_id].cages[step],
            self.run.structures[shape_id],
            self.run.latent(shape_id, step).cpu().numpy(),
            self.run.similarities[shape_id],
        )

    def edited(self, state: State, script: Script) -> History:
        """The states that a script leads to. Raises InputError as `operations.edited` and `check_editable`."""
        self.check_editable()
        return edited(state, script, self.styles)

    def check_editable(self) -> None:
        """Raise InputError for an arm that knows no cuboids."""
        if self.run.decoder.trains_on == "cube":
            raise InputError("this arm was trained without cuboids: there is nothing to edit; take one such as cagesdf")

    def live(
        self,
        resolution: int,
        method: str = "sparse",
        loose: str = "keep",
        symmetry: str = "none",
        fineness: Fineness = USUAL,
    ) -> "Live":
        """A source of the surfaces of one state after another; the choices are extraction's, by name."""
        return Live(LiveSurface(resolution, METHODS[method], LOOSE[loose], SYMMETRIES[symmetry], fineness), self.run)


class Live:
    """Surfaces of states, of which only what has changed since the last ones is evaluated."""

    def __init__(self, live: LiveSurface, run: Run) -> None:
        self._live = live
        self._run = run

    def surface(self, state: State, each: Each = map) -> Extraction:
        """The surface of a state, canonical: closed, outward and within its cuboids, or without faces.

        With `each` a pool's `map`, cuboids are evaluated side by side; the surface is the same.
        """
        return self._live.surface(state_field(self._run, state), each)


def state_field(run: Run, state: State) -> CageField:
    """The field of a state: its parts have the codes of its latent and their residuals, or a style of their own."""
    device = run.latents.values.device
    field = field_of(run.decoder, torch.from_numpy(state.latent).to(device), state.cage, state.seen)
    if field.cage is not state.cage:  # of a decoder that doesn't know cuboids
        return field
    seen = field.codes.clone()
    for part, residual in state.residuals.items():
        seen[state.seen.part_ids.index(part)] += torch.from_numpy(residual).to(device)
    codes = seen[[state.seen.part_ids.index(state.seen_as(part)) for part in state.cage.part_ids]]
    # Parts of one other shape come from one evaluation of its cage.
    known: dict[tuple[bytes, bytes], Float[Tensor, "p k"]] = {}
    for part, steps in state.part_styles.items():
        row = state.cage.part_ids.index(part)
        for step in steps:
            cage = state.seen if step.cage is None else step.cage
            key = step.latent.tobytes(), cage.vectors().tobytes()
            if key not in known:
                known[key] = part_codes(run.decoder, torch.from_numpy(step.latent).to(device), cage)
            owner = state.seen_as(part) if step.cage is None else step.part
            # At both ends of the way, lerp gives the end itself, to the last bit.
            codes[row] = torch.lerp(codes[row], known[key][cage.part_ids.index(owner)], step.weight)
    return CageField(run.decoder, codes, state.cage, state.evaluated())


def export_of(extraction: Extraction, state: State) -> ExportedShape:
    """A state's surface, canonical, as it is given to users."""
    return as_given(extraction.mesh, extraction.parts, state.cage, state.structure, state.similarity)


def as_given(
    mesh: Mesh, parts: Mapping[str, Mesh], cage: Cage, structure: Structure, similarity: Similarity
) -> ExportedShape:
    """A canonical surface and its parts in the user's frame, with the cuboids; `similarity` is raw → canonical.

    Raises InputError for a place or size that files can't hold; see `exported.Place`.
    """
    names = part_names(structure)
    cuboids = {
        names[part]: Mesh(similarity.to_raw(corners), CUBE_FACES)
        for part, corners in zip(cage.part_ids, cage.corners())
    }
    raw = {
        names.get(part, part): solid.with_vertices(similarity.to_raw(solid.vertices)) for part, solid in parts.items()
    }
    return ExportedShape.of(mesh.with_vertices(similarity.to_raw(mesh.vertices)), raw, cuboids)
