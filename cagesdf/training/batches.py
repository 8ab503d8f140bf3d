"""From chunks of points to batches of groups: a cage, a part of it and a latent beside each chunk (§3.5)."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from torch import Tensor

from cagesdf.cuboid import Cage, Sequence
from cagesdf.errors import InputError
from cagesdf.io.points import CHUNK, PointChunks, PointsOf
from cagesdf.models.decoders import TrainsOn
from cagesdf.models.latents import SHARED, LatentTable


@dataclass(frozen=True, eq=False)
class Cages:
    """The cages of deformed shapes, side by side, padded to the parts of the largest."""

    cuboids: Float[Tensor, "s p 15"]  # canonical; places without a part hold a unit cube
    present: Bool[Tensor, "s p"]  # the places that have a part
    latent: Int[Tensor, " s"]  # row of the latent table

    @staticmethod
    def of(cages: Iterable[tuple[Cage, int]]) -> "Cages":
        """Cages, each with its latent's row."""
        known = list(cages)
        places = max(len(cage) for cage, _ in known)
        empty = np.concatenate([np.zeros(3), np.eye(3).ravel(), np.ones(3)])
        cuboids = np.tile(empty.astype(np.float32), (len(known), places, 1))
        for row, (cage, _) in enumerate(known):
            cuboids[row, : len(cage)] = cage.vectors()
        counts = torch.tensor([len(cage) for cage, _ in known])
        present = torch.arange(places) < counts[:, None]
        return Cages(torch.from_numpy(cuboids), present, torch.tensor([row for _, row in known]))

    def take(self, rows: Int[Tensor, " k"]) -> "Cages":
        """The cages of these rows, with no more places than they need."""
        present = self.present[rows]
        places = int(present.sum(dim=1).max()) if len(rows) else 0
        return Cages(self.cuboids[rows, :places], present[:, :places], self.latent[rows])

    def to(self, device: torch.device | str) -> "Cages":
        """The same cages on another device."""
        return Cages(self.cuboids.to(device), self.present.to(device), self.latent.to(device))


@dataclass(frozen=True, eq=False)
class Batch:
    """Groups of points; the whole training set is one, too."""

    points: Float[Tensor, "g n 3"]  # canonical
    sdf: Float[Tensor, "g n"]  # canonical units, negative inside
    weight: Float[Tensor, " g"]  # see `shape_weights`
    shape: Int[Tensor, " g"]  # row of the points' cage
    part: Int[Tensor, " g"]  # place in that
    cages: Cages  # deformed as their shapes are

    @property
    def cuboid(self) -> Float[Tensor, "g 15"]:
        """The cuboid of each group's part."""
        return self.cages.cuboids[self.shape, self.part]

    def take(self, groups: Int[Tensor, " k"]) -> "Batch":
        """The groups at these positions."""
        return replace(self, **{name: getattr(self, name)[groups] for name in _BY_GROUP})

    def run(self, groups: slice) -> "Batch":
        """A run of the groups; no copy."""
        return replace(self, **{name: getattr(self, name)[groups] for name in _BY_GROUP})

    def to(self, device: torch.device | str) -> "Batch":
        """The same batch on another device, with the cages that its groups have."""
        used, shape = self.shape.unique(return_inverse=True)
        points, sdf, weight, shape, part = (
            tensor.to(device) for tensor in (self.points, self.sdf, self.weight, shape, self.part)
        )
        return Batch(points, sdf, weight, shape, part, self.cages.take(used).to(device))

    @staticmethod
    def joined(batches: "list[Batch]") -> "Batch":
        """The groups of batches that have the same cages."""
        if len(batches) == 1:
            return batches[0]
        points, sdf, weight, shape, part = (
            torch.cat([getattr(batch, name) for batch in batches]) for name in _BY_GROUP
        )
        return Batch(points, sdf, weight, shape, part, batches[0].cages)


_BY_GROUP = ("points", "sdf", "weight", "shape", "part")


class Batches(ABC):
    """The batch of each step: a function of the step, not of earlier calls."""

    @abstractmethod
    def at(self, step: int) -> Batch:
        """The groups that one step trains on."""


def training_chunks(
    chunks: PointChunks,
    sequences: Mapping[str, Sequence],
    steps_of: Literal["all", "rest"],
    trains_on: TrainsOn,
    reach: float,
    rng: np.random.Generator,
) -> PointChunks:
    """The chunks that an arm trains on.

    `steps_of` rest keeps the source shapes alone. Of those that train on a cage only points inside
    their cuboid or at most `reach` (canonical units) outside it are kept, in new chunks; others keep all. Raises
    InputError as `Owners.of` does, and naming a shape of which nothing is left.
    """
    shapes = np.unique(chunks.shape_id)
    if steps_of == "rest":
        chunks = chunks.take(np.flatnonzero(chunks.step == 0))
    if trains_on == "cage":
        keep = cuboid_distance(chunks.xyz, Owners.of(chunks, sequences).cuboids()) <= reach
        chunks = rechunk(chunks, keep, rng)
    lost = np.setdiff1d(shapes, chunks.shape_id)
    refuse_lost([chunks.shape_ids[shape] for shape in lost], not len(shapes), steps_of, trains_on, reach)
    return chunks


def refuse_lost(lost: list[str], nothing: bool, steps_of: str, trains_on: str, reach: float) -> None:
    """Raise InputError if a selection left nothing of these shapes, or there was `nothing` to select from."""
    if lost or nothing:
        where = f", which counts points within {reach} of their cuboid (reach)" if trains_on == "cage" else ""
        raise InputError(
            f"no {CHUNK} points to train on of shape(s) {', '.join(lost[:5]) or 'any'} with steps_of {steps_of} "
            f"and a decoder that trains on the {trains_on}{where}; see which the shards have with cagesdf inspect"
        )


def kind_of(trains_on: TrainsOn) -> PointsOf:
    """The shards that have the points of decoders that train on this."""
    return "part" if trains_on == "part" else "shape"


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


@dataclass(frozen=True, eq=False)
class Owners:
    """Whose each chunk's points are."""

    deformed: tuple[tuple[str, int], ...]  # the deformed shapes, (shape id, step) each, sorted by number of the shape
    cages: tuple[Cage, ...]  # theirs
    shape: Int[ndarray, " c"]  # by chunk, number of its deformed shape
    part: Int[ndarray, " c"]  # by chunk, place of its part in the cage

    @staticmethod
    def of(chunks: PointChunks, sequences: Mapping[str, Sequence]) -> "Owners":
        """Raises InputError if the sequences lack a chunk's shape, step or part."""
        keys, shape = np.unique(np.stack([chunks.shape_id, chunks.step], axis=1), axis=0, return_inverse=True)
        deformed = tuple((chunks.shape_ids[number], step) for number, step in keys.tolist())
        cages = tuple(cage_of(sequences, *key) for key in deformed)
        pairs, inverse = np.unique(np.stack([shape.reshape(-1), chunks.part], axis=1), axis=0, return_inverse=True)
        place = np.empty(len(pairs), np.int64)
        for i, (number, part) in enumerate(pairs.tolist()):
            part_id, (shape_id, step) = chunks.part_ids[part], deformed[number]
            if part_id not in cages[number].part_ids:
                raise InputError(f"shape {shape_id}, step {step}: has points of part {part_id} but no such cuboid")
            place[i] = cages[number].part_ids.index(part_id)
        return Owners(deformed, cages, shape.reshape(-1), place[inverse.reshape(-1)])

    def cuboids(self) -> Float[ndarray, "c 15"]:
        """The 15-vector of each chunk's cuboid, float32."""
        counts = np.array([len(cage) for cage in self.cages], np.int64)
        vectors = np.array([vector for cage in self.cages for vector in cage.vectors()], np.float32).reshape(-1, 15)
        return vectors[(np.cumsum(counts) - counts)[self.shape] + self.part]


def cage_of(sequences: Mapping[str, Sequence], shape_id: str, step: int) -> Cage:
    """The cage of one deformed shape. Raises InputError if there is none."""
    if shape_id not in sequences or step >= len(sequences[shape_id].cages):
        raise InputError(f"shape {shape_id}, step {step}: has points but no cage; rerun sample_points")
    return sequences[shape_id].cages[step]


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
    """All chunks, each with its cage, its place in it and its weight. Raises InputError as `Owners.of` does."""
    owners = Owners.of(chunks, sequences)
    rows = [latents.row(*key) for key in owners.deformed]
    return Batch(
        torch.from_numpy(chunks.xyz),
        torch.from_numpy(chunks.sdf),
        torch.from_numpy(shape_weights(chunks)),
        torch.from_numpy(owners.shape),
        torch.from_numpy(owners.part),
        Cages.of(zip(owners.cages, rows, strict=True)),
    )


def bundled(owner: Int[ndarray, " c"], bundle: int, rng: np.random.Generator) -> Int[ndarray, " c"]:
    """Positions of all groups in a random order in which `bundle` of one owner follow each other.

    An owner's last bundle has the remaining groups. With bundles of one group it is any permutation.
    """
    order = rng.permutation(len(owner))
    order = order[np.argsort(owner[order], kind="stable")]
    rank = np.arange(len(order)) - np.searchsorted(owner[order], owner[order])
    starts = np.flatnonzero(rank % bundle == 0)
    lengths = np.diff(np.append(starts, len(order)))
    place = rng.permutation(len(starts))
    first = starts[place]
    within = np.arange(len(order)) - np.repeat(np.cumsum(lengths[place]) - lengths[place], lengths[place])
    return order[np.repeat(first, lengths[place]) + within]


class BatchOrder:
    """Which groups each step trains on: one random order of all after the other, cut into batches.

    A function of (seed, step) and nothing else, so that a resumed training goes on as if it had
    never stopped. A batch may straddle two orders, and bundles (see `bundled`) two batches.
    """

    def __init__(self, owner: Int[ndarray, " c"], batch: int, bundle: int, seed: int) -> None:
        self.owner = owner
        self.batch = batch
        self.bundle = bundle
        self.seed = seed
        self._orders: dict[int, Int[ndarray, " c"]] = {}

    def at(self, step: int) -> Int[Tensor, " k"]:
        """Positions of the groups of one step."""
        groups = len(self.owner)
        start, stop = step * self.batch, (step + 1) * self.batch
        epochs = range(start // groups, (stop - 1) // groups + 1)
        self._orders = {epoch: self._order(epoch) for epoch in epochs}
        stream = np.concatenate([self._orders[epoch] for epoch in epochs])
        first = start - epochs[0] * groups
        return torch.from_numpy(stream[first : first + self.batch])

    def _order(self, epoch: int) -> Int[ndarray, " c"]:
        if epoch in self._orders:
            return self._orders[epoch]
        return bundled(self.owner, self.bundle, np.random.default_rng([self.seed, epoch]))


class MemoryBatches(Batches):
    """Batches of groups that are in memory, in the order of `BatchOrder`."""

    def __init__(self, groups: Batch, batch: int, bundle: int, seed: int) -> None:
        self.groups = groups
        self.order = BatchOrder(groups.shape.numpy(), batch, bundle, seed)

    def at(self, step: int) -> Batch:
        """The groups that one step trains on."""
        return self.groups.take(self.order.at(step))
