"""The points that an arm trains on: in memory where they fit, streamed from their shards where they don't."""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Int
from numpy import ndarray
from torch import Tensor

from cagesdf.cuboid import Sequence
from cagesdf.io.points import CHUNK, PointChunks, count_groups, count_points, read_groups, read_points, shard_paths
from cagesdf.models.decoders import TrainsOn
from cagesdf.models.latents import LatentTable
from cagesdf.training.batches import (
    Batch,
    Batches,
    Cages,
    MemoryBatches,
    Owners,
    bundled,
    cage_of,
    cuboid_distance,
    kind_of,
    latent_keys,
    refuse_lost,
    shared_or_own,
    training_chunks,
    training_set,
)

BYTES_A_POINT = 110  # that reading, selecting and cutting into new chunks takes at its peak
BLOCK = 16  # row groups that are read in one go
POOL = 4  # blocks whose chunks are mixed: a million points

Steps = Literal["all", "rest"]


class TrainingPoints(ABC):
    """The points of one arm: how many, of which shapes, in which batches. What to select is as in `training_chunks`."""

    sampled: int  # points in the shards
    used: int  # of them, those the arm trains on

    @abstractmethod
    def latent_keys(self, latents: Literal["source", "deformed"]) -> tuple[tuple[str, int], ...]:
        """Keys of the latent table: one a source shape, or one a deformed shape, in sorted order."""

    @abstractmethod
    def batches(self, latents: LatentTable, batch: int, bundle: int, seed: int) -> Batches:
        """Batches of `batch` groups, `bundle` of a deformed shape in a row, in an order drawn from `seed`."""


def open_points(
    folder: Path,
    sequences: Mapping[str, Sequence],
    steps_of: Steps,
    trains_on: TrainsOn,
    reach: float,
    rng: np.random.Generator,
    memory: int,
) -> TrainingPoints:
    """The points of a `points/` artefact in memory if that takes at most `memory` bytes, else streamed.

    Raises InputError as `training_chunks` does.
    """
    if count_points(folder, kind_of(trains_on)) * BYTES_A_POINT <= memory:
        return LoadedPoints(folder, sequences, steps_of, trains_on, reach, rng)
    return StreamedPoints(folder, sequences, steps_of, trains_on, reach)


class LoadedPoints(TrainingPoints):
    """All of them in memory, in new chunks where points were left out."""

    def __init__(
        self,
        folder: Path,
        sequences: Mapping[str, Sequence],
        steps_of: Steps,
        trains_on: TrainsOn,
        reach: float,
        rng: np.random.Generator,
    ) -> None:
        chunks = read_points(folder, kind_of(trains_on))
        self.sampled = len(chunks) * CHUNK
        self._chunks = training_chunks(chunks, sequences, steps_of, trains_on, reach, rng)
        self._sequences = sequences
        self.used = len(self._chunks) * CHUNK

    def latent_keys(self, latents: Literal["source", "deformed"]) -> tuple[tuple[str, int], ...]:
        """As in `TrainingPoints`."""
        return latent_keys(self._chunks, latents)

    def batches(self, latents: LatentTable, batch: int, bundle: int, seed: int) -> Batches:
        """As in `TrainingPoints`; the whole training set's order is shuffled."""
        return MemoryBatches(training_set(self._chunks, self._sequences, latents), batch, bundle, seed)


@dataclass(frozen=True)
class Block:
    """Row groups of one shard, one after the other."""

    path: Path
    groups: range


class StreamedPoints(TrainingPoints):
    """Points that stay in their shards; a first pass counts those of each deformed shape.

    Chunks stay as they were sampled. Where only some points of a chunk are trained on, those fill
    the others' places, all equally often on average, and the chunk's weight falls in proportion:
    the objective is the same as in memory, for somewhat more work. Memory doesn't grow with the data:
    see `StreamedBatches`.
    """

    def __init__(
        self, folder: Path, sequences: Mapping[str, Sequence], steps_of: Steps, trains_on: TrainsOn, reach: float
    ) -> None:
        self.sequences, self.steps_of, self.trains_on, self.reach = sequences, steps_of, trains_on, reach
        self.sampled = count_points(folder, kind_of(trains_on))
        self.blocks = [
            Block(path, range(start, min(start + BLOCK, groups)))
            for path in shard_paths(folder, kind_of(trains_on))
            for groups in (count_groups(path),)
            for start in range(0, groups, BLOCK)
        ]
        self.chunks: list[int] = []  # of each block, those with points to train on
        self.points: dict[tuple[str, int], int] = defaultdict(int)  # of each deformed shape, those to train on
        seen: set[str] = set()
        for block in self.blocks:
            chunks, keep = self.read(block)
            self._count(chunks, keep)
            seen.update(chunks.shape_ids)
        refuse_lost(sorted(seen - {shape_id for shape_id, _ in self.points}), not seen, steps_of, trains_on, reach)
        self.used = sum(self.points.values())

    def read(self, block: Block) -> tuple[PointChunks, Bool[ndarray, "c n"]]:
        """The chunks of a block in which there are points to train on, and which those are."""
        chunks = read_groups(block.path, block.groups)
        keep = np.ones(chunks.sdf.shape, bool)
        if self.steps_of == "rest":
            keep &= (chunks.step == 0)[:, None]
        if self.trains_on == "cage":
            keep &= cuboid_distance(chunks.xyz, Owners.of(chunks, self.sequences).cuboids()) <= self.reach
        rows = np.flatnonzero(keep.any(axis=1))
        return chunks.take(rows), keep[rows]

    def _count(self, chunks: PointChunks, keep: Bool[ndarray, "c n"]) -> None:
        self.chunks.append(len(chunks))
        keys, inverse = np.unique(np.stack([chunks.shape_id, chunks.step]), axis=1, return_inverse=True)
        counts = np.bincount(inverse.reshape(-1), weights=keep.sum(axis=1), minlength=keys.shape[1])
        for shape, step, count in zip(*keys.tolist(), counts.tolist()):
            self.points[chunks.shape_ids[shape], step] += int(count)

    def latent_keys(self, latents: Literal["source", "deformed"]) -> tuple[tuple[str, int], ...]:
        """As in `TrainingPoints`."""
        return shared_or_own(sorted(self.points), latents)

    def batches(self, latents: LatentTable, batch: int, bundle: int, seed: int) -> Batches:
        """As in `TrainingPoints`; each is drawn from a pool of blocks."""
        return StreamedBatches(self, latents, batch, bundle, seed)


@dataclass(frozen=True)
class Piece:
    """Some chunks in a row of one pool."""

    epoch: int
    pool: int
    start: int
    stop: int
    end: int  # where the pool ends in the endless row of epochs


@dataclass(frozen=True, eq=False)
class Plan:
    """The order of one epoch."""

    blocks: Int[ndarray, " b"]  # POOL after POOL
    ends: Int[ndarray, " p"]  # chunks up to the end of each pool


class StreamedBatches(Batches):
    """Batches from pools of blocks, which a thread reads ahead.

    Each epoch orders all blocks anew and cuts that order into pools of POOL; each pool orders its
    chunks anew; batches are cut from these chunks in a row. All this is a function of `seed`,
    epoch and pool, so that a resumed training goes on as if it had never stopped. The pool in use and
    the next are held, and those that a batch straddles.
    """

    def __init__(self, source: StreamedPoints, latents: LatentTable, batch: int, bundle: int, seed: int) -> None:
        self.source, self.batch, self.bundle, self.seed = source, batch, bundle, seed
        deformed = sorted(source.points)
        self.rows = {key: row for row, key in enumerate(deformed)}
        self.cages = Cages.of((cage_of(source.sequences, *key), latents.row(*key)) for key in deformed)
        self.counts = np.array(source.chunks)
        self.total = int(self.counts.sum())
        self._thread = ThreadPoolExecutor(1)
        self._pools: dict[tuple[int, int], Future[tuple[Batch, Tensor]]] = {}
        self._plans: dict[int, Plan] = {}

    def at(self, step: int) -> Batch:
        """The groups that one step trains on."""
        pieces = self._pieces(step * self.batch, (step + 1) * self.batch)
        last = pieces[-1]
        following = self._pieces(last.end, last.end + 1)[0]
        wanted = dict.fromkeys((piece.epoch, piece.pool) for piece in [*pieces, following])
        self._plans = {epoch: self._plans[epoch] for epoch, _ in wanted}
        self._pools = {key: self._pools.get(key) or self._thread.submit(self._read, *key) for key in wanted}
        pieces_groups = []
        for piece in pieces:
            groups, order = self._pools[piece.epoch, piece.pool].result()
            pieces_groups.append(groups.take(order[piece.start : piece.stop]))
        return Batch.joined(pieces_groups)

    def _pieces(self, start: int, stop: int) -> list[Piece]:
        """Where the chunks from `start` to `stop` of the endless row of epochs are."""
        pieces = []
        while start < stop:
            epoch, place = divmod(start, self.total)
            if epoch not in self._plans:
                self._plans[epoch] = self._plan(epoch)
            ends = self._plans[epoch].ends
            pool = int(np.searchsorted(ends, place, side="right"))
            begin, end = int(ends[pool - 1]) if pool else 0, int(ends[pool])
            count = min(stop - start, end - place)
            pieces.append(Piece(epoch, pool, place - begin, place - begin + count, epoch * self.total + end))
            start += count
        return pieces

    def _plan(self, epoch: int) -> Plan:
        order = np.random.default_rng([self.seed, epoch]).permutation(len(self.counts))
        last = np.append(np.arange(POOL, len(order), POOL), len(order)) - 1
        return Plan(order, np.cumsum(self.counts[order])[last])

    def _read(self, epoch: int, pool: int) -> tuple[Batch, Tensor]:
        """The groups of one pool, and the order in which they are used."""
        rng = np.random.default_rng([self.seed, epoch, pool])
        blocks = self._plans[epoch].blocks[pool * POOL : (pool + 1) * POOL].tolist()
        groups = Batch.joined([self._groups(self.source.blocks[block], rng) for block in blocks])
        return groups, torch.from_numpy(bundled(groups.shape.numpy(), self.bundle, rng))

    def _groups(self, block: Block, rng: np.random.Generator) -> Batch:
        chunks, keep = self.source.read(block)
        slots = filled(keep, rng)
        owners = Owners.of(chunks, self.source.sequences)
        # As `shape_weights`, with points instead of chunks: C k / (S N).
        share = self.counts.sum() / len(self.source.points)
        say = np.array([share / self.source.points[shape] for shape in owners.deformed])
        rows = np.array([self.rows[shape] for shape in owners.deformed], np.int64)
        return Batch(
            torch.from_numpy(np.take_along_axis(chunks.xyz, slots[:, :, None], axis=1)),
            torch.from_numpy(np.take_along_axis(chunks.sdf, slots, axis=1)),
            torch.from_numpy((say[owners.shape] * keep.sum(axis=1)).astype(np.float32)),
            torch.from_numpy(rows[owners.shape]),
            torch.from_numpy(owners.part),
            self.cages,
        )


def filled(keep: Bool[ndarray, "c n"], rng: np.random.Generator) -> Int[ndarray, "c n"]:
    """Positions of the kept entries of each row, at least one, repeated in turn until the row is full.

    Which are repeated once more than others is random.
    """
    order = np.argsort(rng.random(keep.shape, np.float32) + ~keep, axis=1)
    turn = np.arange(keep.shape[1]) % keep.sum(axis=1, keepdims=True)
    return np.take_along_axis(order, turn, axis=1)
