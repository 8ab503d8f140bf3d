"""Shapes that come from users' files, and the parts of whole ones as they were changed by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from jaxtyping import Float32
from numpy import ndarray

from cagesdf.editing.document import Document
from cagesdf.editing.script import Build, Style
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.parts.changing import Dissection
from cagesdf.shape import Origin, RawShape
from cagesdf.structure.base import Structure
from cagesdf.structure.hierarchy import PartHierarchy


@dataclass(frozen=True, eq=False)
class Taken:
    """A shape from files, as the network has it."""

    structure: Structure  # with cuboids, canonical
    latent: Float32[ndarray, " d"]
    residuals: Mapping[str, Sequence[float]]  # by part, added to the part's code
    similarity: Similarity  # raw → canonical
    truth: Mesh  # its own surface, canonical
    origin: Origin  # of its parts
    verdict: str  # likeness to the training shapes

    def operations(self) -> tuple[Build, Style]:
        """The operations that lead from any shape to it."""
        residuals = {part: tuple(numbers) for part, numbers in self.residuals.items()}
        return (
            Build(structure=self.structure.to_json(), frame=tuple(self.similarity.to_numbers())),
            Style(code=tuple(self.latent.tolist()), residuals=residuals),
        )


@dataclass(frozen=True, eq=False)
class Upload:
    """A file that a shape comes from."""

    file: str  # as the user calls it
    raw: RawShape
    truth: Mesh  # the surface of the closed parts, canonical
    origin: Origin  # of the parts that it came in with
    # By the structure that was built of each; grows as parts are found and changed.
    dissections: dict[str, Dissection] = field(default_factory=dict)

    @property
    def bytes(self) -> int:
        """Estimate of its memory: each dissection has about the file's faces again."""
        meshes = [part.mesh for part in self.raw.parts]
        whole = sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in meshes)
        return whole * (1 + len(self.dissections)) + self.truth.vertices.nbytes + self.truth.faces.nbytes

    def build(self, dissection: Dissection) -> Build:
        """The operation that shows the parts of a dissection, which is kept, before the network has seen them."""
        parts = dissection.result.parts
        ids, labels = tuple(part.name for part in parts), tuple(part.label for part in parts)
        structure = PartHierarchy.flat(ids, labels, "").with_cuboids(dissection.cage().cuboids())
        text = structure.to_json()
        self.dissections[text] = dissection
        return Build(structure=text, frame=tuple(dissection.placement.to_numbers()))

    def newest(self, document: Document) -> Dissection | None:
        """The dissection that a document's parts are of; None if they are those that it came in with."""
        built = next((step for step in reversed(document.done) if isinstance(step, Build)), None)
        return None if built is None else self.dissections.get(built.structure)

    def unfitted(self, document: Document) -> Dissection | None:
        """The dissection that a document shows, if the network hasn't seen its parts yet."""
        done = document.done
        return self.newest(document) if done and isinstance(done[-1], Build) else None
