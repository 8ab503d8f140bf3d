"""From chunks of points to batches of groups: a cuboid and a latent beside each chunk (§3.5)."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from torch import Tensor

from cagesdf.cuboid import Sequence
from cagesdf.errors import InputError
from cagesdf.io.points import CHUNK, PointChunks
from cagesdf.models.latents import SHARED, LatentTable


@dataclass(frozen=True, eq=False)
class Batch:
    """Groups of points; the whole training set is one, too."""

    points: Float[Tensor, "g n 3"]  # canonical
    sdf: Float[Tensor, "g n"]  # canonical units, negative inside
    cuboid: Float[Tensor, "g 15"]  # of the points' part, deformed as their shape is
    latent: Int[Tensor, " g"]  # row of the latent table
    weight: Float[Tensor, " g"]  # see `shape_weights`

    def take(self, groups: Int[Tensor, " k"]) -> "Batch":
        """The groups at these positions."""
        return Batch(*(getattr(self, name)[groups] for name in self.__dataclass_fields__))

    def part(self, groups: slice) -> "Batch":
        """A run of the groups; no copy."""
        return Batch(*(getattr(self, name)[groups] for name in self.__dataclass_fields__))

    def to(self, device: torch.device | str) -> "Batch":
        """The same batch on another device."""
        return Batch(*(getattr(self, name).to(device) for name in self.__dataclass_fields__))


class Batches(ABC):
    """The batch of each step: a function of the step, not of what was asked before."""

    @abstractmethod
    def at(self, step: int) -> Batch:
        """The groups that one step trains on."""


def training_chunks(
    chunks: PointChunks,
    sequences: Mapping[str, Sequence],
    steps_of: Literal["all", "rest"],
    points_of: Literal["cage", "cube"],
    reach: float,
    rng: np.random.Generator,
) -> PointChunks:
    """The chunks that an arm trains on.

    `steps_of` rest keeps the source shapes alone. `points_of` cage keeps the points inside their
    cuboid or at most `reach` (canonical units) outside it, in new chunks; cube keeps all. Raises
    InputError as `own_cuboids` does, and naming a shape of which nothing is left.
    """
    shapes = np.unique(chunks.shape_id)
    if steps_of == "rest":
        chunks = chunks.take(np.flatnonzero(chunks.step == 0))
    if points_of == "cage":
        keep = cuboid_distance(chunks.xyz, own_cuboids(chunks, sequences)) <= reach
        chunks = rechunk(chunks, keep, rng)
    lost = np.setdiff1d(shapes, chunks.shape_id)
    refuse_lost([chunks.shape_ids[shape] for shape in lost], not len(shapes), steps_of, points_of, reach)
    return chunks


def refuse_lost(lost: list[str], nothing: bool, steps_of: str, points_of: str, reach: float) -> None:
    """Raise InputError if a selection left nothing of these shapes, or there was `nothing` to select from."""
    if lost or nothing:
        raise InputError(
            f"no {CHUNK} points to train on of shape(s) {', '.join(lost[:5]) or 'any'} "
            f"with steps_of {steps_of}, points_of {points_of} and reach {reach}"
        )


def latent_keys(chunks: PointChunks, latents: Literal["source", "deformed"]) -> tuple[tuple[str, int], ...]:
    """Keys of the latent table: one a source shape, or one a deformed shape, in sorted order."""
    pairs = np.unique(np.stack([chunks.shape_id, chunks.step], axis=1), axis=0)
    return shared_or_own([(chunks.shape_ids[shape], step) for shape, step in pairs.tolist()], latents)


def shared_or_own(
    deformed: list[tuple[str, int]], latents: Literal["source", "deformed"]
) -> tuple[tuple[str, int], ...]:
    """The keys of `latent_keys` for deformed shapes, (shape id, step) each, sorted."""
    if latents == "source":
        return tuple((shape_id, SHARED) for shape_id in dict.fromkeys(shape_id for shape_id, _ in deformed))
    return tuple(deformed)


def own_cuboids(chunks: PointChunks, sequences: Mapping[str, Sequence]) -> Float[ndarray, "c 15"]:
    """The 15-vector of each chunk's cuboid, float32.

    Raises InputError if the sequences lack a chunk's shape, step or part.
    """
    keys, inverse = np.unique(
        np.stack([chunks.shape_id, chunks.step, chunks.part], axis=1), axis=0, return_inverse=True
    )
    vectors = np.empty((len(keys), 15), np.float32)
    for i, (shape, step, part) in enumerate(keys.tolist()):
        shape_id, part_id = chunks.shape_ids[shape], chunks.part_ids[part]
        if shape_id not in sequences or step >= len(sequences[shape_id].cages):
            raise InputError(f"shape {shape_id}, step {step}: has points but no cage; rerun sample_points")
        cage = sequences[shape_id].cages[step]
        if part_id not in cage.part_ids:
            raise InputError(f"shape {shape_id}, step {step}: has points of part {part_id} but no such cuboid")
        vectors[i] = cage.vectors()[cage.part_ids.index(part_id)]
    return vectors[inverse.reshape(-1)]


def cuboid_distance(points: Float[ndarray, "c n 3"], cuboids: Float[ndarray, "c 15"]) -> Float[ndarray, "c n"]:
    """Signed distance of each point to its chunk's cuboid, canonical units, negative inside."""
    local = (points - cuboids[:, None, :3]) @ cuboids[:, 3:12].reshape(-1, 3, 3).swapaxes(1, 2)
    beyond = np.abs(local) - cuboids[:, None, 12:] / 2
    return np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0)


def rechunk(chunks: PointChunks, keep: Bool[ndarray, "c n"], rng: np.random.Generator) -> PointChunks:
    """The kept points in new chunks; what doesn't fill a chunk of its shape, step and part is dropped at random."""
    keys, group = np.unique(np.stack([chunks.shape_id, chunks.step, chunks.part], axis=1), axis=0, return_inverse=True)
    kept = rng.permutation(np.flatnonzero(keep))
    kept = kept[np.argsort(group.reshape(-1)[kept // CHUNK], kind="stable")]
    group = group.reshape(-1)[kept // CHUNK]
    counts = np.bincount(group, minlength=len(keys))
    rank = np.arange(len(kept)) - np.repeat(np.cumsum(counts) - counts, counts)
    kept = kept[rank < (counts // CHUNK * CHUNK)[group]].reshape(-1, CHUNK)
    owner = kept[:, 0] // CHUNK
    return replace(
        chunks.take(owner),
        xyz=chunks.xyz.reshape(-1, 3)[kept],
        sdf=chunks.sdf.reshape(-1)[kept],
        near=chunks.near.reshape(-1)[kept],
    )


def shape_weights(chunks: PointChunks) -> Float[ndarray, " c"]:
    """Weights that make every deformed shape count the same (§3.5's 1/P_ij).

    With C chunks of S deformed shapes, n of them this chunk's own shape's: C / (S n). The mean
    over all chunks of weight × mean error is then the paper's mean over shapes of their own
    means, and that of a batch drawn uniformly is an unbiased estimate of it.
    """
    _, shape, counts = np.unique(
        np.stack([chunks.shape_id, chunks.step], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return (len(chunks) / (len(counts) * counts[shape.reshape(-1)])).astype(np.float32)


def training_set(chunks: PointChunks, sequences: Mapping[str, Sequence], latents: LatentTable) -> Batch:
    """All chunks, each with its cuboid, its latent's row and its weight. Raises InputError as `own_cuboids` does."""
    keys, inverse = np.unique(np.stack([chunks.shape_id, chunks.step], axis=1), axis=0, return_inverse=True)
    rows = np.array([latents.row(chunks.shape_ids[shape], step) for shape, step in keys.tolist()], np.int64)
    return Batch(
        torch.from_numpy(chunks.xyz),
        torch.from_numpy(chunks.sdf),
        torch.from_numpy(own_cuboids(chunks, sequences)),
        torch.from_numpy(rows[inverse.reshape(-1)]),
        torch.from_numpy(shape_weights(chunks)),
    )


class BatchOrder:
    """Which groups each step trains on: one random permutation of all after the other, cut into batches.

    A function of (seed, step) and nothing else, so that a resumed training goes on as if it had
    never stopped. A batch may straddle two permutations.
    """

    def __init__(self, groups: int, batch: int, seed: int) -> None:
        self.groups = groups
        self.batch = batch
        self.seed = seed
        self._permutations: dict[int, Int[ndarray, " c"]] = {}

    def at(self, step: int) -> Int[Tensor, " k"]:
        """Positions of the groups of one step."""
        start, stop = step * self.batch, (step + 1) * self.batch
        epochs = range(start // self.groups, (stop - 1) // self.groups + 1)
        self._permutations = {epoch: self._permutation(epoch) for epoch in epochs}
        stream = np.concatenate([self._permutations[epoch] for epoch in epochs])
        first = start - epochs[0] * self.groups
        return torch.from_numpy(stream[first : first + self.batch])

    def _permutation(self, epoch: int) -> Int[ndarray, " c"]:
        if epoch in self._permutations:
            return self._permutations[epoch]
        return np.random.default_rng([self.seed, epoch]).permutation(self.groups)


class MemoryBatches(Batches):
    """Batches of groups that are in memory, in the order of `BatchOrder`."""

    def __init__(self, groups: Batch, batch: int, seed: int) -> None:
        self.groups = groups
        self.order = BatchOrder(len(groups.weight), batch, seed)

    def at(self, step: int) -> Batch:
        """The groups that one step trains on."""
        return self.groups.take(self.order.at(step))
