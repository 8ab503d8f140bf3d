"""A trained run: its shapes to edit, new shapes, and shapes that it wasn't trained on."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import repeat
from math import inf
from pathlib import Path
from typing import Literal

import torch

from cagesdf.api.display import run_html
from cagesdf.api.shapes import EditableShape, FittedShape
from cagesdf.api.sources import Source, imported
from cagesdf.cage_generation.generator import Generated
from cagesdf.cage_generation.trained import TrainedGenerator
from cagesdf.demo import DEMO
from cagesdf.editing.naming import KnownParts
from cagesdf.editing.session import Session
from cagesdf.errors import InputError
from cagesdf.inference import shapes as inference
from cagesdf.io.cage_generators import GENERATOR, read_generator
from cagesdf.io.residuals import read_residuals
from cagesdf.io.runs import beside, read_run
from cagesdf.seeds import item_rng
from cagesdf.shape_generation.cages import CageDraws
from cagesdf.shape_generation.surfaces import (
    CodeSource,
    Order,
    code_source,
    has_cuboids,
    methods_of,
    of_program,
    orders,
    usual_method,
)
from cagesdf.structure.parsing import read_program

MOST = 100_000  # new shapes
CodeMethod = Literal["independent", "dependent", "by_part"]


def load_run(folder: Path | str, programs: Path | str | None = None) -> "TrainedRun":
    """A trained run, such as data/runs/chair/cagesdf; "demo" is the small one that comes with the package.

    A folder of that name comes before it.

    `programs` is a folder that `train_programs` wrote, for new cuboids; without it, data/programs/chair for the run
    above. Raises InputError for a folder that isn't a run, and for files that are damaged.
    """
    if str(folder) == "demo" and not Path(folder).exists():
        return TrainedRun(DEMO / "run", DEMO / "programs")
    return TrainedRun(Path(folder), None if programs is None else Path(programs))


@dataclass(frozen=True, eq=False)
class NewShapes:
    """Orders of new shapes, drawn as they are taken."""

    method: str  # one of `shape_generation.surfaces.methods_of` the run
    source: CodeSource
    orders: Iterator[Order]


class TrainedRun:
    """A trained network with the shapes that it was trained on."""

    def __init__(self, folder: Path, programs: Path | None = None) -> None:
        """As `load_run`."""
        self.folder = folder
        self.session = Session(read_run(folder))
        self._programs = programs

    @property
    def shapes(self) -> tuple[str, ...]:
        """The ids of its shapes, sorted."""
        return tuple(sorted(self.session.run.sequences))

    def open(self, shape_id: str, step: int = 0) -> EditableShape:
        """One of its shapes, to edit; `step` is one of its deformation sequence. InputError if there is none."""
        return EditableShape(self.session, shape_id, self.session.opened(shape_id, step))

    def generate(
        self,
        count: int,
        seed: int = 0,
        *,
        latent: CodeMethod | None = None,
        temperature: float = 1.0,
        program: Path | str | None = None,
    ) -> list[EditableShape]:
        """New shapes, to edit: new cuboids and new codes, in the canonical frame. The same for the same seed.

        `latent` "by_part", the default where parts have codes of their own, takes codes of shapes that have parts like
        the new ones; "dependent" makes codes of shapes with similar cuboids likelier. `temperature` 0 gives the middle
        of what was trained on. `program` is a ShapeAssembly program whose cuboids all shapes get. Shapes
        with a cuboid too thin to edit are left out.
        """
        self.session.check_editable()
        with one_thread():
            drawn = [*self.draw(count, seed, latent=latent, temperature=temperature, program=program).orders]
        return [shape for order in drawn if (shape := self._built(order)) is not None]

    def draw(
        self,
        count: int,
        seed: int = 0,
        *,
        latent: CodeMethod | None = None,
        temperature: float = 1.0,
        program: Path | str | None = None,
    ) -> NewShapes:
        """Cages and codes that `generate` makes shapes of, for runs without cuboids too.

        Raises InputError if nothing can be drawn.
        """
        if not 1 <= count <= MOST:
            raise InputError(f"count {count}: wanted 1 to {MOST:,}")
        check_seed(seed)
        if not 0 <= temperature < inf:
            raise InputError(f"temperature {temperature}: wanted 0 or more; 1 is usual")
        run = self.session.run
        cages: Iterable[tuple[int, Generated | None]]
        if not has_cuboids(run):
            if latent or program or self._programs:
                given = "latent, program and programs say nothing to it"
                raise InputError(f"{self.folder}: was trained without cuboids, so {given}")
            cages = ((number, None) for number in range(count))
        elif program is not None:
            cages = repeat((0, of_program(read_program(Path(program)), run)), count)
        else:
            draws = CageDraws(self._generator, item_rng(seed, "cages"), count, temperature)
            cages = _valid(draws)
        method = latent or usual_method(run)
        if method not in methods_of(run):
            raise InputError(f"latent {method!r}: {self.folder} has {', '.join(methods_of(run))}")
        source = code_source(run, method, None)
        return NewShapes(
            method, source, orders(cages, method, source, seed, partial(item_rng, seed, "code"), temperature)
        )

    def fit(self, source: Source, seed: int = 0) -> FittedShape:
        """A shape that it wasn't trained on, with the code that explains it best.

        `source` is a mesh file, a folder of part meshes, a PartNet shape, or meshes. Raises InputError if it is not a
        single shape or can't be closed, and for a run without cuboids.
        """
        check_seed(seed)
        with one_thread():
            shape = imported(source)
            fit = inference.fit_shape(self.session.run, self._known, shape, inference.usual_settings(), seed)
        return FittedShape(self.session, fit)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.folder}; {len(self.shapes)} shapes>"

    def _repr_html_(self) -> str:
        return run_html(str(self.folder), {name: self.session.run.sequences[name].cages[0] for name in self.shapes})

    @cached_property
    def known_parts(self) -> KnownParts:
        """The labelled parts of its shapes, after which parts of new programs are called."""
        return KnownParts.of(self.session.styles.shapes.values())

    @cached_property
    def _known(self) -> inference.Known:
        return inference.Known.of(self.session.run, read_residuals(self.folder))

    @cached_property
    def _generator(self) -> TrainedGenerator:
        folder = self._programs or beside(self.folder, "programs")
        if not (folder / GENERATOR).is_file():
            what = "programs" if self._programs else f"new cuboids for {self.folder} are looked for in {folder}"
            wanted = "a folder that train_programs wrote (dvc repro train_programs); or give a program"
            raise InputError(f"{what}: there is no {folder / GENERATOR}; wanted {wanted}")
        return read_generator(folder)

    def _built(self, order: Order) -> EditableShape | None:
        if order.generated is None:
            return None
        document = self.known_parts.document(order.generated.structure, order.generated.cage)
        shape = self.open(self.shapes[0])
        try:
            code = order.code
            return shape.build(document).style(code.latent.tolist(), parts=code.part_latents)
        except InputError:  # a cuboid that is too thin
            return None


def _valid(draws: CageDraws) -> Iterator[tuple[int, Generated]]:
    """All draws. InputError at their end if none was valid."""
    none = True
    for item in draws:
        none = False
        yield item
    if none:
        reasons = "; ".join(f"{number} times: {reason}" for reason, number in sorted(draws.failures.items()))
        raise InputError(f"no draw gave a valid shape ({reasons}); train it longer, or lower the temperature")


def check_seed(seed: int) -> None:
    """Raise InputError for a seed below 0."""
    if seed < 0:
        raise InputError(f"seed {seed}: wanted 0 or more")


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch has one thread inside: with several, sums would be taken in another order on another machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
