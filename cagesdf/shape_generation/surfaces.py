"""New surfaces from a trained network: cages, codes for them, surfaces, and whether they hold (§4.4)."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray
from scipy.spatial.distance import cdist

from cagesdf.cage_generation.cage_distance import cage_distances
from cagesdf.cage_generation.generator import Generated
from cagesdf.cage_generation.latent_kde import IsotropicGaussian, LatentKde, effective_number, similarity_weights
from cagesdf.cage_generation.novelty import reach_of, standing
from cagesdf.cuboid import Cage
from cagesdf.deformation.likeness import relative_boxes
from cagesdf.errors import InputError
from cagesdf.extraction import Extraction, extract, field_of
from cagesdf.extraction.field import CageField
from cagesdf.extraction.surface import Loose
from cagesdf.geometry.meshes import sample_surface
from cagesdf.models.codes import part_codes
from cagesdf.run import Run
from cagesdf.shape_generation.generated import BROKEN, EMPTY, OK, GeneratedShape
from cagesdf.shape_generation.simulated_stability import stays_standing
from cagesdf.shape_generation.static_stability import rooted, stable
from cagesdf.structure.assembly import Assembly
from cagesdf.structure.executor import execute
from cagesdf.structure.program import AssemblyProgram

LIKE = 0.3  # two parts are alike whose boxes relative to their shapes' are at most this far apart (`relative_boxes`)
NO_CAGE = Cage.of({})
Item = TypeVar("Item")
Result = TypeVar("Result")
STABILITIES: Mapping[str, Callable[[Cage], bool]] = {"support": stable, "simulation": stays_standing}


@dataclass(frozen=True, eq=False)
class Code:
    """A latent code that was drawn."""

    latent: Float32[ndarray, " d"]
    effective: float  # number of kernels that it may come from
    part_latents: Mapping[str, Float32[ndarray, " d"]] = field(default_factory=dict)  # of the parts with another one


class CodeSource(ABC):
    """A source of codes for new shapes; see `code_source`."""

    @abstractmethod
    def draw(self, rng: np.random.Generator, cage: Cage, temperature: float) -> Code:
        """A code for a cage. `temperature` scales how far codes are from the training codes, or from their mean."""

    def about(self) -> dict[str, Any]:
        """Facts about the source, for JSON."""
        return {}


@dataclass(frozen=True, eq=False)
class Independent(CodeSource):
    """The paper's ⊥: the training codes' density, whatever the cage."""

    kde: LatentKde

    def draw(self, rng: np.random.Generator, cage: Cage, temperature: float) -> Code:
        """See `CodeSource.draw`; the cage plays no part."""
        return _drawn(self.kde, self.kde.uniform(1), rng, temperature)


@dataclass(frozen=True, eq=False)
class Dependent(CodeSource):
    """The training codes' density, those of similar cages weighing more."""

    kde: LatentKde
    cages: Sequence[Cage]  # of the codes, canonical
    tau: float  # see `similarity_weights`; canonical units
    paper: float  # median effective number of kernels that τ = 1 would give the training cages

    @staticmethod
    def fit(kde: LatentKde, cages: Sequence[Cage], tau: float | None) -> "Dependent":
        """A density with `tau`, or if it is None with that under which the training codes are likeliest."""
        apart = cage_distances(cages, cages)
        chosen = kde.likeliest_tau(apart) if tau is None else tau
        return Dependent(kde, cages, chosen, float(np.median(effective_number(similarity_weights(apart, 1.0)))))

    def weights(self, cage: Cage) -> np.ndarray:
        """The kernels' weights for one cage, as one row."""
        return similarity_weights(cage_distances([cage], self.cages), self.tau)

    def draw(self, rng: np.random.Generator, cage: Cage, temperature: float) -> Code:
        """See `CodeSource.draw`."""
        return _drawn(self.kde, self.weights(cage), rng, temperature)

    def about(self) -> dict[str, Any]:
        """τ, and the number of kernels in effect were it 1."""
        return {"tau": self.tau, "kernels": len(self.cages), "effective_at_1": self.paper}


@dataclass(frozen=True, eq=False)
class ByPart(CodeSource):
    """As `Dependent`, but parts get codes from training shapes that have a part like them (ours; not in the paper).

    A code says nothing of parts that its shape doesn't have: of a vase without a handle it makes a board for one. So
    those training shapes are candidates that have parts like the most of the new ones. Parts that are unlike all of the
    chosen shape's get another code in the same way, which the network reads in the same cage.
    """

    dependent: Dependent

    @cached_property
    def _boxes(self) -> list[Float[ndarray, "p 6"]]:
        return [relative_boxes(cage) for cage in self.dependent.cages]

    def draw(self, rng: np.random.Generator, cage: Cage, temperature: float) -> Code:
        """See `CodeSource.draw`."""
        boxes = relative_boxes(cage)
        apart = np.array([cdist(known, boxes).min(axis=0) for known in self._boxes])
        distances = cage_distances([cage], self.dependent.cages)[0]
        left, codes = np.ones(len(boxes), bool), list[tuple[Code, ndarray]]()
        while left.any():
            alike = (apart <= LIKE) & left
            fit = alike.sum(axis=1)
            if not fit.any():  # the shape whose parts are nearest has the rest
                fit, alike = -apart[:, left].sum(axis=1), np.broadcast_to(left, apart.shape)
            [candidates] = np.nonzero(fit == fit.max())
            weights = similarity_weights(distances[None, candidates], self.dependent.tau)
            chosen = candidates[rng.choice(len(candidates), p=weights[0])]
            [latent] = self.dependent.kde.sample(rng, np.eye(len(distances))[[chosen]], temperature)
            codes.append((Code(latent.astype(np.float32), float(effective_number(weights)[0])), alike[chosen]))
            left = left & ~alike[chosen]
        (first, _), *others = codes
        by_part = {cage.part_ids[part]: code.latent for code, parts in others for part in np.flatnonzero(parts)}
        return replace(first, part_latents=by_part)

    def about(self) -> dict[str, Any]:
        """As of `Dependent`."""
        return self.dependent.about()


@dataclass(frozen=True, eq=False)
class Isotropic(CodeSource):
    """DeepSDF's density: one Gaussian fitted to all codes."""

    gaussian: IsotropicGaussian

    def draw(self, rng: np.random.Generator, cage: Cage, temperature: float) -> Code:
        """See `CodeSource.draw`; there is no cage."""
        return Code(self.gaussian.sample(rng, 1, temperature)[0].astype(np.float32), 1.0)


def _drawn(kde: LatentKde, weights: np.ndarray, rng: np.random.Generator, temperature: float) -> Code:
    [code] = kde.sample(rng, weights, temperature)
    return Code(code.astype(np.float32), float(effective_number(weights)[0]))


def has_cuboids(run: Run) -> bool:
    """Whether an arm was trained on cuboids; the others make whole shapes from a code alone."""
    return run.decoder.trains_on != "cube"


def methods_of(run: Run) -> tuple[str, ...]:
    """The methods of drawing codes for an arm, as in Table 3."""
    if not has_cuboids(run):
        return ("isotropic",)
    return ("independent", "dependent") if run.decoder.code_dim is None else ("independent", "dependent", "by_part")


def usual_method(run: Run) -> str:
    """The method by which users' new shapes get their codes: the last of `methods_of` the arm."""
    return methods_of(run)[-1]


def code_source(run: Run, method: str, tau: float | None) -> CodeSource:
    """One of `methods_of` an arm; `tau` as for `Dependent.fit`."""
    if method == "isotropic":
        return Isotropic(IsotropicGaussian.fit(run.latents.values.double().cpu().numpy()))
    kde = LatentKde.fit(np.stack([run.latent(name, 0).double().cpu().numpy() for name in sorted(run.sequences)]))
    if method == "independent":
        return Independent(kde)
    dependent = Dependent.fit(kde, rest_cages(run), tau)
    return ByPart(dependent) if method == "by_part" else dependent


def rest_cages(run: Run) -> list[Cage]:
    """The training shapes' cages, in the order of their ids."""
    return [run.sequences[name].cages[0] for name in sorted(run.sequences)]


def of_program(program: AssemblyProgram, run: Run) -> Generated:
    """A program placed as the training shapes are: in the middle, as far out as they are in the median."""
    assembly = Assembly(program, standing(execute(program), reach_of(rest_cages(run))))
    return Generated(assembly, assembly.cage())


@dataclass(frozen=True)
class Extracting:
    """Settings of the extraction of new surfaces, and the test of stability for their cages."""

    resolution: int  # cells along [-HALF_EXTENT, HALF_EXTENT]
    loose: Loose
    points: int  # on each surface
    stable: Callable[[Cage], bool]  # one of STABILITIES


@dataclass(frozen=True, eq=False)
class Order:
    """A shape that is to be made."""

    method: str
    shape_id: str
    seed: int
    draw: int
    generated: Generated | None  # None where the arm knows no cuboids
    code: Code


def orders(
    drawn: Iterable[tuple[int, Generated | None]],
    method: str,
    source: CodeSource,
    seed: int,
    rng_of: Callable[[int], np.random.Generator],
    temperature: float,
) -> Iterator[Order]:
    """Orders for numbered draws by one method; orders with equal numbers share random numbers across methods."""
    for i, (number, generated) in enumerate(drawn):
        code = source.draw(rng_of(i), generated.cage if generated is not None else NO_CAGE, temperature)
        yield Order(method, f"{i:05d}", seed, number, generated, code)


def in_order(pool: Executor, make: Callable[[Item], Result], items: Iterable[Item], ahead: int) -> Iterator[Result]:
    """Results of a pool for each item, in order; at most `ahead` are submitted beyond the one that is consumed.

    A pool's own `map` would submit all items at once, however slowly the results are consumed.
    """
    waiting: deque[Future[Result]] = deque()
    for item in items:
        waiting.append(pool.submit(make, item))
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def make_shape(run: Run, how: Extracting, rng: np.random.Generator, order: Order) -> GeneratedShape:
    """The surface of one new shape, points on it, and its checks; one that is empty or broken says so.

    Raises InputError if the network gives values that are not finite.
    """
    cage = order.generated.cage if order.generated is not None else NO_CAGE
    surface, status = _surface(run, how, order.code, cage)
    mesh = surface.mesh
    points = sample_surface(mesh, how.points, rng)[0] if len(mesh.faces) else np.zeros((0, 3))
    standing_on = order.generated is not None and rooted(cage)
    return GeneratedShape(
        order.method,
        order.shape_id,
        order.seed,
        order.draw,
        order.generated.structure if order.generated is not None else None,
        cage,
        order.generated.floating if order.generated is not None else 0,
        order.code.latent,
        order.code.part_latents,
        order.code.effective,
        status,
        mesh,
        surface.components,
        surface.clipped,
        surface.evaluations,
        standing_on,
        standing_on and how.stable(cage),
        points.astype(np.float32),
        surface.parts,
    )


def _surface(run: Run, how: Extracting, code: Code, cage: Cage) -> tuple[Extraction, str]:
    try:
        surface = extract(_field(run, code, cage), how.resolution, loose=how.loose)
    except InputError:  # the network's fault, not the shape's
        raise
    except ValueError as error:
        return Extraction.nothing(), f"{BROKEN}: {error}"
    return surface, OK if len(surface.mesh.faces) else EMPTY


def _field(run: Run, code: Code, cage: Cage) -> CageField:
    device = run.latents.values.device
    field = field_of(run.decoder, torch.from_numpy(code.latent).to(device), cage)
    if not code.part_latents:
        return field
    codes = field.codes.clone()
    for part, latent in code.part_latents.items():
        row = cage.part_ids.index(part)
        codes[row] = part_codes(run.decoder, torch.from_numpy(latent).to(device), cage)[row]
    return CageField(run.decoder, codes, cage)


def counts(rows: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """Counts of an index's rows: `shapes` (all), `ok`, `empty`, `broken`, `one_piece`.

    For an arm with cuboids also `rooted`, `stable`, and `floating`: cuboids in mid-air that were left out.
    """
    result = dict.fromkeys(("shapes", OK, EMPTY, BROKEN, "one_piece"), 0)
    checks = dict.fromkeys(("rooted", "stable", "floating"), 0)
    cuboids = False
    for row in rows:
        result["shapes"] += 1
        result[row["status"].partition(":")[0]] += 1
        result["one_piece"] += row["components"] == 1
        cuboids |= bool(row["part_ids"])
        for name in checks:
            checks[name] += row[name]
    return result | checks if cuboids else result
