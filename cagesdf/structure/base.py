"""What a stage may ask of a structure, whatever holds the parts together."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from cagesdf.cuboid import Cuboid
from cagesdf.structure.relations import Relation


class Structure(ABC):
    """The parts of a shape and how they belong together. Immutable."""

    @abstractmethod
    def parts(self) -> tuple[str, ...]:
        """Ids of the parts that have a mesh and a cuboid, in a fixed order."""

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
    def with_cuboids(self, cuboids: Mapping[str, Cuboid]) -> "Structure":
        """The same structure with new cuboids for its parts."""

    @abstractmethod
    def signatures(self) -> dict[str, str]:
        """By node id, a text that two subtrees share if they are equal up to continuous parameters (§3.3)."""

    def signature(self) -> str:
        """The root's signature: that of the whole structure."""
        return self.signatures()[self.root()]

    @abstractmethod
    def to_json(self) -> str:
        """One line that the class's `from_json` reads back."""
