"""New structures: programs that ShapeAssembly's autoencoder writes (§4.4)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from cagesdf.cage_generation.decoding import Written, decode
from cagesdf.cage_generation.generator import Generated, Generator, Samples, samples_of
from cagesdf.cage_generation.novelty import standing
from cagesdf.cage_generation.program_vae import ProgramVAE
from cagesdf.cage_generation.tokens import tokens_of
from cagesdf.frames import Similarity
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.executor import execute
from cagesdf.structure.program import AssemblyProgram


@dataclass(frozen=True, eq=False)
class ProgramGenerator(Generator):
    """Programs from ShapeAssembly's autoencoder."""

    model: ProgramVAE
    reach: float  # distance of the farthest corner of a cage, canonical units: the training cages' median

    def sample(self, rng: np.random.Generator, count: int, temperature: float) -> Samples:
        """See `Generator.sample`; the normal numbers are the programs' codes."""
        codes = temperature * rng.standard_normal((count, self.model.code))
        written = decode(self.model.decoder, torch.from_numpy(codes).float())
        return samples_of([item if isinstance(item, str) else self.placed(item) for item in written])

    def placed(self, written: Written) -> Generated:
        """A program where a shape's would be."""
        similarity: Similarity = standing(execute(written.program), self.reach)
        assembly = Assembly(written.program, similarity)
        return Generated(assembly, assembly.cage(), written.floating)

    def rebuilt(self, programs: Mapping[str, AssemblyProgram]) -> dict[str, Generated | str]:
        """Programs written anew from their own mean codes, or the reasons why that fails."""
        codes = self.model.codes([tokens_of(program) for program in programs.values()])
        written = decode(self.model.decoder, codes)
        return {name: item if isinstance(item, str) else self.placed(item) for name, item in zip(programs, written)}
