"""A generator of cages together with what it was trained on."""

from collections.abc import Mapping
from dataclasses import dataclass

from cagesdf.cage_generation.generator import Generator
from cagesdf.cage_generation.novelty import Known
from cagesdf.cuboid import Cage
from cagesdf.structure.base import Structure


@dataclass(frozen=True, eq=False)
class TrainedGenerator:
    """A generator and its training shapes."""

    generator: Generator
    structures: Mapping[str, Structure]  # by shape id
    cages: Mapping[str, Cage]  # by shape id, canonical

    def known(self) -> Known:
        """The training shapes, which samples are compared with."""
        return Known(self.structures, self.cages)
