"""The interface of structures, whatever holds the parts together."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.frames import Similarity
from cagesdf.structure.program import AssemblyProgram
from cagesdf.structure.relations import Relation


class Structure(ABC):
    """The parts of a shape and how they belong together. Immutable."""

    @abstractmethod
    def parts(self) -> tuple[str, ...]:
        """Ids of the parts that have a mesh and a cuboid, in a fixed order."""

    @abstractmethod
    def labels(self) -> dict[str, str]:
        """Semantic names by part id, "" where none is known; several parts may share one."""

    @abstractmethod
    def children(self, node: str) -> tuple[str, ...]:
        """Ids of a node's children, empty for a part. The root is `root()`."""

    @abstractmethod
    def root(self) -> str:
        """Id of the node that holds all others."""

    @abstractmethod
    def relations(self) -> tuple[Relation, ...]:
        """Attachments and symmetries between siblings."""

    @abstractmethod
    def cage(self) -> Cage:
        """The parts' cuboids that it stores. Raises InputError where it stores none."""

    @abstractmethod
    def transformed(self, similarity: Similarity) -> "Structure":
        """The same structure, all its lengths and places taken through a similarity."""

    def placed_program(self) -> tuple[AssemblyProgram, Similarity] | None:
        """The program that its cuboids follow from, and program → canonical; None where they are free of each other."""
        return None

    def with_program(self, program: AssemblyProgram) -> "Structure":
        """The structure with another program in the same place. Raises ValueError where there is none."""
        raise ValueError(f"the cuboids of {type(self).__name__} are free of each other, there is no program")

    def with_cuboids(self, cuboids: Mapping[str, Cuboid]) -> "Structure":
        """The same structure with new cuboids, by part id. Relations connect the same parts as before.

        Raises ValueError where cuboids follow from a program.
        """
        raise ValueError(f"the cuboids of {type(self).__name__} follow from its program; change that")

    def is_bare(self) -> bool:
        """Whether it has only ids and labels of its parts, so that relations may be looked for."""
        return False

    def with_relations(self, relations: tuple[Relation, ...]) -> "Structure":
        """The structure with relations that were found between its parts; they don't count in signatures.

        Raises ValueError where it isn't bare.
        """
        raise ValueError(f"{type(self).__name__} tells its parts' relations itself")

    @abstractmethod
    def signatures(self) -> dict[str, str]:
        """Signatures by node id: subtrees that are equal up to continuous parameters have the same text (§3.3)."""

    def signature(self) -> str:
        """The root's signature: that of the whole structure."""
        return self.signatures()[self.root()]

    @abstractmethod
    def to_json(self) -> str:
        """One line that the class's `from_json` reads back."""
