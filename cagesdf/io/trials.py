"""`trials/`: edits whose true outcome is known.

trials.parquet      one row a trial, in a row group of its own
references.parquet  what needs no network, measured: see io.edits
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cagesdf.cuboid import Cage
from cagesdf.errors import InputError
from cagesdf.evaluation.trials import Trial
from cagesdf.geometry.meshes import Mesh
from cagesdf.io.metadata import COMPRESSION, Column, Layout, read_block

KIND = "trials"
NAMES = ("trial_id", "kind", "shape_id", "style_of", "part_id")
TRIALS = Layout(
    "trials",
    1,
    (
        Column("trial_id", pa.string(), "unique in its category"),
        Column(
            "kind", pa.string(), "rest, local, beyond, bent, swap, warp, mix, mix_warp or mix_keep: see docs/metrics.md"
        ),
        Column("shape_id", pa.string(), "whose cuboids these are, or were before they moved"),
        Column("style_of", pa.string(), "whose latent a network is given"),
        Column(
            "part_id", pa.string(), "the part whose cuboid was edited; of mixes those that take the style, joined by |"
        ),
        Column("part_ids", pa.list_(pa.string()), "of the cuboids"),
        Column("cuboids", pa.list_(pa.float64()), "of each cuboid: centre (3), axes by rows (9), full lengths (3)"),
        Column("vertices", pa.list_(pa.float32()), "x, y, z of each vertex of the true surface in turn"),
        Column("faces", pa.list_(pa.int32()), "three vertex indices of each of its faces in turn, outwards"),
        Column("changed", pa.list_(pa.bool_()), "of each face, whether its part's style changed; all where none did"),
    ),
    {"frame": "canonical"},
)


def write_trials(folder: Path, trials: Iterable[Trial], definitions: Mapping[str, Any], left_out: int) -> None:
    """Write trials, sorted, how they are to be measured, and how many were left out as too thin."""
    facts = {"definitions": dict(definitions), "left_out": left_out}
    with pq.ParquetWriter(folder / "trials.parquet", TRIALS.schema(**facts), **COMPRESSION) as writer:
        for trial in sorted(trials, key=lambda trial: trial.trial_id):
            row = {
                **{name: getattr(trial, name) for name in NAMES},
                "part_ids": trial.cage.part_ids,
                "cuboids": trial.cage.vectors().ravel(),
                "vertices": trial.truth.vertices.astype(np.float32).ravel(),
                "faces": trial.truth.faces.ravel(),
                "changed": trial.changed,
            }
            writer.write_table(TRIALS.table([row], **facts))


class TrialFolder:
    """The trials of an artefact, read one at a time; cheap to send to another process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def _file(self) -> pq.ParquetFile:
        return TRIALS.open(self.folder / "trials.parquet")

    @cached_property
    def rows(self) -> dict[str, dict[str, Any]]:
        """The description of each trial by its id, sorted."""
        return {row["trial_id"]: row for row in self._file.read(columns=list(NAMES)).to_pylist()}

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder}

    @property
    def definitions(self) -> dict[str, Any]:
        """Settings of the trials' measurement."""
        return read_block(self._file.schema_arrow, self.folder)["definitions"]

    def counts(self) -> dict[str, int]:
        """Numbers of trials of each kind, and of those left out because a cuboid was too thin."""
        kinds = Counter(row["kind"] for row in self.rows.values())
        return {**kinds, "left_out": read_block(self._file.schema_arrow, self.folder)["left_out"]}

    def read(self, trial_id: str) -> Trial:
        """One trial. Raises InputError if there is none of that id."""
        if trial_id not in self.rows:
            raise InputError(f"{self.folder}: has no trial {trial_id!r}; it holds {', '.join(list(self.rows)[:4])} ...")
        table = self._file.read_row_group(list(self.rows).index(trial_id))
        part_ids = tuple(table["part_ids"][0].as_py())
        numbers = {
            name: table[name][0].values.to_numpy(zero_copy_only=False)
            for name in ("cuboids", "vertices", "faces", "changed")
        }
        return Trial(
            **{name: table[name][0].as_py() for name in NAMES},
            cage=Cage.from_vectors(part_ids, numbers["cuboids"].reshape(-1, 15)),
            truth=Mesh(numbers["vertices"].reshape(-1, 3).astype(np.float64), numbers["faces"].reshape(-1, 3)),
            changed=numbers["changed"],
        )


def read_trials(folder: Path) -> TrialFolder:
    """Open `trials/` for reading, a trial at a time."""
    return TrialFolder(folder)
