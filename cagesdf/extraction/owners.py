"""The part whose surface each face of a shape comes from."""

import numpy as np
from jaxtyping import Float, Int, UInt64
from numpy import ndarray

from cagesdf.cuboid import Cage
from cagesdf.extraction.promises import Meshes
from cagesdf.geometry.meshes import Mesh

MULTIPLIERS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)  # odd


def face_owners(mesh: Mesh, parts: Meshes, cage: Cage) -> Int[ndarray, " f"]:
    """For each face of the union of `parts`, the cuboid of the part that it lies on, by its number in the cage.

    A union keeps the vertices of its parts to the last bit, but for those where two surfaces cross. A face of nothing
    but such, one in some hundreds, belongs to the cuboid that holds its centre most (`Cage.assign`).
    """
    numbers = {part_id: number for number, part_id in enumerate(cage.part_ids)}
    counts = [len(part.vertices) for part in parts.values()]
    keys = _keys(np.concatenate([np.zeros((0, 3)), *(part.vertices for part in parts.values())]))
    parts_of_keys = np.repeat(np.array([numbers[part_id] for part_id in parts], np.int64), counts)
    order = np.argsort(keys)
    keys, wanted = keys[order], _keys(mesh.vertices)
    places = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
    known = keys[places] == wanted if len(keys) else np.zeros(len(wanted), bool)
    of_vertices = np.full(len(wanted), -1)
    of_vertices[known] = parts_of_keys[order[places[known]]]
    owners = of_vertices[mesh.faces].max(axis=1, initial=-1)
    unknown = np.flatnonzero(owners < 0)
    if len(unknown):
        owners[unknown], _ = cage.assign(mesh.corners()[unknown].mean(axis=1))
    return owners


def _keys(vertices: Float[ndarray, "n 3"]) -> UInt64[ndarray, " n"]:
    """A number for each place, other ones for other places as good as surely."""
    bits = np.ascontiguousarray(vertices + 0.0).view(np.uint64)  # -0.0 is 0.0
    bits ^= bits >> np.uint64(31)
    return (bits * MULTIPLIERS).sum(axis=1, dtype=np.uint64)
