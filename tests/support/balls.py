"""A network that knows balls, a run of pairs of them, and new pairs."""

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch

from cagesdf.cuboid import Cage, Cuboid, Sequence
from cagesdf.frames import Similarity
from cagesdf.geometry.meshes import Mesh
from cagesdf.inference import shapes as inference
from cagesdf.io.residuals import write_residuals
from cagesdf.models.decoders import Decoder, TrainsOn
from cagesdf.models.latents import SHARED, LatentTable
from cagesdf.run import Run
from cagesdf.structure.hierarchy import PartHierarchy
from tests.support import toy


class Balls(Decoder):
    """In every cuboid a ball whose radius is its code's first number; the other does nothing."""

    trains_on: ClassVar[TrainsOn] = "cage"

    def features(self, points: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return points - cuboid[:, None, :3]

    def condition(self, code: torch.Tensor, cuboid: torch.Tensor) -> torch.Tensor:
        return code[:, :1]

    def evaluate(self, features: torch.Tensor, condition: torch.Tensor, compute_dtype: torch.dtype) -> torch.Tensor:
        return features.norm(dim=2) - condition


RADII = {"chair_1": 0.30, "chair_2": 0.36, "chair_3": 0.42}


SIDES = {"a": -0.62, "b": 0.62}


SETTINGS = replace(
    inference.usual_settings(),
    points=100,
    counts=replace(inference.usual_settings().counts, near=1500, uniform=100, part_near=128.0, part_uniform=16.0),
    inference=replace(
        inference.usual_settings().inference, code_steps=40, residual_steps=40, code_weight=0.0, residual_weight=0.0
    ),
)  # fmt: skip


def pair(left: float, right: float, apart: float = 0.6) -> dict[str, Mesh]:
    """Two balls side by side, all within the unit ball."""
    return {"a": toy.ball([-apart, 0, 0], left, 64), "b": toy.ball([apart, 0, 0], right, 64)}


def trained(params: dict[str, object] | None = None) -> Run:
    """A run that knows pairs of balls of equal radius."""
    table = LatentTable(
        tuple((name, SHARED) for name in RADII), torch.tensor([[r, 0.0] for r in RADII.values()])
    ).requires_grad_(False)
    cages = {
        name: Cage.of({part: Cuboid(np.array([x, 0, 0]), np.eye(3), np.full(3, 2 * r)) for part, x in SIDES.items()})
        for name, r in RADII.items()
    }
    sequences = {name: Sequence(name, None, np.zeros(1), (False,), (cage,)) for name, cage in cages.items()}
    structures = {name: PartHierarchy.flat(("a", "b"), ("ball",) * 2, "pair") for name in RADII}
    similarities = {name: Similarity(1.0, np.eye(3), np.zeros(3)) for name in RADII}
    about = {"reach": 0.02, "latent_dim": 2, "clamp": 0.0, **(params or {})}
    return Run(Balls(), table, sequences, structures, similarities, about, {"sampled": 1, "used": 1})


RESIDUALS = {"chair_1": 0.0015, "chair_2": 0.002, "chair_3": 0.003}


def write_pair(folder: Path, place: tuple[float, float, float] = (7, -3, 5)) -> Path:
    for name, mesh in pair(0.36, 0.36).items():
        toy.write_obj(folder / f"{name}.obj", mesh.with_vertices(2.5 * mesh.vertices + place))
    return folder


def write_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is read as the run of pairs, with quick settings for `fit`."""
    folder.mkdir()
    write_residuals(folder, RESIDUALS)
    monkeypatch.setattr("cagesdf.api.runs.read_run", lambda path: trained())
    monkeypatch.setattr(inference, "usual_settings", lambda: SETTINGS)
    return folder
