"""`points/`: signed distance samples in shards that serve training.

    shape-0000.parquet …   of whole shapes: distances to the union of their parts (§3.4)
    part-0000.parquet …    of parts: distances to the part's own surface, the part moved by its own cuboid alone

A chunk is CHUNK rows that share shape, step and part, so that a network's FiLM parameters are
computed once for all of them. The order of chunks is shuffled over the shard; a row group is
CHUNKS_PER_GROUP chunks, so any row group is a random batch of groups, and so are some in a row.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from cagesdf.errors import InputError
from cagesdf.io.metadata import COMPRESSION, Column, Layout

KIND = "points"
PointsOf = Literal["shape", "part"]  # the surface that distances are to
CHUNK = 64
CHUNKS_PER_GROUP = 256
_IDS = pa.dictionary(pa.int32(), pa.string())
POINTS = Layout(
    "points",
    2,
    (
        Column("shape_id", _IDS, "the source shape"),
        Column("step", pa.int32(), "step of its sequence, 0 is the rest shape"),
        Column("part_id", _IDS, "the part; of a shape's points that whose cuboid most contains the point"),
        Column("x", pa.float32(), "canonical units"),
        Column("y", pa.float32(), "canonical units"),
        Column("z", pa.float32(), "canonical units"),
        Column(
            "sdf",
            pa.float32(),
            "signed distance to the surface of the deformed shape or of its part; canonical units",
        ),
        Column("where", _IDS, "near: importance sampled, or around the part; uniform: in the cube or in the cuboid"),
    ),
    {
        "frame": "canonical",
        "sign": "negative inside",
        "scale": "the source shape's farthest vertex is at 1",
        "clamp": "none",
        "chunk": CHUNK,
    },
)


@dataclass(frozen=True, eq=False)
class PointChunks:
    """Samples in chunks of CHUNK that share shape, step and part."""

    shape_id: Int[ndarray, " c"]  # index into shape_ids
    step: Int[ndarray, " c"]
    part: Int[ndarray, " c"]  # index into part_ids
    xyz: Float[ndarray, "c 64 3"]  # canonical, float32
    sdf: Float[ndarray, "c 64"]  # canonical units, negative inside, float32
    near: Bool[ndarray, "c 64"]  # importance sampled rather than uniform
    shape_ids: tuple[str, ...]  # names behind shape_id
    part_ids: tuple[str, ...]  # names behind part

    def __len__(self) -> int:
        return len(self.step)

    def take(self, order: Int[ndarray, " k"]) -> "PointChunks":
        """The chunks at these positions."""
        return PointChunks(
            self.shape_id[order],
            self.step[order],
            self.part[order],
            self.xyz[order],
            self.sdf[order],
            self.near[order],
            self.shape_ids,
            self.part_ids,
        )


def join_chunks(pieces: Iterable[PointChunks]) -> PointChunks:
    """All chunks together; ids are renumbered over the sorted union of names."""
    pieces = list(pieces)
    shape_ids = tuple(sorted({name for piece in pieces for name in piece.shape_ids}))
    part_ids = tuple(sorted({name for piece in pieces for name in piece.part_ids}))

    def renumber(values: ndarray, old: tuple[str, ...], new: tuple[str, ...]) -> ndarray:
        place = {name: i for i, name in enumerate(new)}
        table = np.array([place[name] for name in old], dtype=np.int32)
        return table[values] if len(old) else np.zeros(0, np.int32)

    return PointChunks(
        np.concatenate([renumber(p.shape_id, p.shape_ids, shape_ids) for p in pieces]),
        np.concatenate([p.step for p in pieces]),
        np.concatenate([renumber(p.part, p.part_ids, part_ids) for p in pieces]),
        np.concatenate([p.xyz for p in pieces]),
        np.concatenate([p.sdf for p in pieces]),
        np.concatenate([p.near for p in pieces]),
        shape_ids,
        part_ids,
    )


def shard_path(folder: Path, of: PointsOf, number: int) -> Path:
    """The path of a shard."""
    return folder / f"{of}-{number:04d}.parquet"


def write_shard(path: Path, pieces: Sequence[PointChunks], rng: np.random.Generator, **facts: object) -> int:
    """Write one shard, the chunks of all pieces in an order drawn from `rng`; returns the number of rows.

    `facts` (of what, sampler, seeds, counts) join the schema's block. Peak memory beyond `pieces`: one row group.
    """
    schema = POINTS.schema(**facts)
    ends = np.cumsum([len(piece) for piece in pieces])
    order = rng.permutation(int(ends[-1]))
    with pq.ParquetWriter(path, schema, use_dictionary=["shape_id", "part_id", "where"], **COMPRESSION) as writer:
        for start in range(0, len(order), CHUNKS_PER_GROUP):
            group = _gathered(pieces, ends, order[start : start + CHUNKS_PER_GROUP])
            writer.write_table(_table(group, schema), row_group_size=CHUNK * CHUNKS_PER_GROUP)
    return len(order) * CHUNK


def _gathered(pieces: Sequence[PointChunks], ends: Int[ndarray, " p"], order: Int[ndarray, " k"]) -> PointChunks:
    """The chunks at these positions of all pieces in a row, without joining those."""
    owner = np.searchsorted(ends, order, side="right")
    by_owner = np.argsort(owner, kind="stable")
    selected = []
    for piece in np.unique(owner).tolist():
        chunks = pieces[piece].take(order[by_owner][owner[by_owner] == piece] - (ends[piece] - len(pieces[piece])))
        used, shape = np.unique(chunks.shape_id, return_inverse=True)
        names = tuple(chunks.shape_ids[i] for i in used.tolist())
        selected.append(replace(chunks, shape_id=shape.astype(np.int32), shape_ids=names))
    return join_chunks(selected).take(np.argsort(by_owner))


def _table(chunks: PointChunks, schema: pa.Schema) -> pa.Table:
    def names(values: ndarray, dictionary: tuple[str, ...]) -> pa.Array:
        return pa.DictionaryArray.from_arrays(pa.array(values, pa.int32()), pa.array(dictionary, pa.string()))

    x, y, z = chunks.xyz.reshape(-1, 3).T
    return pa.Table.from_arrays(
        [
            names(np.repeat(chunks.shape_id, CHUNK), chunks.shape_ids),
            pa.array(np.repeat(chunks.step, CHUNK), pa.int32()),
            names(np.repeat(chunks.part, CHUNK), chunks.part_ids),
            pa.array(x, pa.float32()),
            pa.array(y, pa.float32()),
            pa.array(z, pa.float32()),
            pa.array(chunks.sdf.ravel(), pa.float32()),
            names(1 - chunks.near.ravel().astype(np.int32), ("near", "uniform")),
        ],
        schema=schema,
    )


def shard_paths(folder: Path, of: PointsOf) -> list[Path]:
    """The shards of an artefact, sorted. Raises InputError if there is none."""
    paths = sorted(folder.glob(f"{of}-*.parquet"))
    if not paths:
        raise InputError(f"{folder}: holds no {of}-*.parquet; wanted the output of sample_points")
    return paths


def count_points(folder: Path, of: PointsOf) -> int:
    """Points in all shards of a kind, without reading them."""
    return sum(POINTS.open(path).metadata.num_rows for path in shard_paths(folder, of))


def count_groups(path: Path) -> int:
    """Row groups of one shard."""
    return int(POINTS.open(path).num_row_groups)


def read_groups(path: Path, groups: Sequence[int]) -> PointChunks:
    """Row groups of one shard by their numbers, in memory."""
    with POINTS.open(path) as file:
        return join_chunks(_chunks(file.read_row_group(i), path) for i in groups)


def read_shard(path: Path) -> Iterator[PointChunks]:
    """The row groups of one shard in turn."""
    file = POINTS.open(path)
    for i in range(file.num_row_groups):
        yield _chunks(file.read_row_group(i), path)


def read_points(folder: Path, of: PointsOf) -> PointChunks:
    """All chunks of all shards of a kind, in memory."""
    return join_chunks(piece for path in shard_paths(folder, of) for piece in read_shard(path))


def _chunks(table: pa.Table, path: Path) -> PointChunks:
    if len(table) % CHUNK:
        raise InputError(f"{path}: a row group of {len(table)} rows, wanted a multiple of {CHUNK}; rerun sample_points")

    def decode(name: str) -> tuple[ndarray, tuple[str, ...]]:
        column = table[name].combine_chunks()
        column = column.chunk(0) if isinstance(column, pa.ChunkedArray) else column
        return column.indices.to_numpy(zero_copy_only=False), tuple(column.dictionary.to_pylist())

    shape, shape_ids = decode("shape_id")
    part, part_ids = decode("part_id")
    where, where_names = decode("where")
    near = np.array([name == "near" for name in where_names])[where]
    xyz = np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1)
    step = table["step"].to_numpy()
    rows = np.stack([shape, step, part]).reshape(3, -1, CHUNK)
    if (rows != rows[:, :, :1]).any():
        raise InputError(f"{path}: a chunk mixes shapes, steps or parts; rerun sample_points")
    return PointChunks(
        rows[0, :, 0],
        rows[1, :, 0],
        rows[2, :, 0],
        xyz.reshape(-1, CHUNK, 3),
        table["sdf"].to_numpy().reshape(-1, CHUNK),
        near.reshape(-1, CHUNK),
        shape_ids,
        part_ids,
    )
