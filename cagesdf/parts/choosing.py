"""Choice between the groups of a file as parts and parts found in the surface."""

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from cagesdf.geometry.meshes import Mesh, join

LOOSE = 2.0  # times the found parts' cuboids' volume: groups whose cuboids have more are no parts
SEAMS = 0.01  # share of the edges: groups with more open edges in common are materials


def doubt(groups: list[Mesh], boxes: float, found_boxes: float, tolerance: float) -> str:
    """Reason why groups of faces are no parts; "" if they are.

    `groups` are canonical, `tolerance` a canonical length. `boxes` and `found_boxes` are the volumes of cuboids over
    that of the shape: of the groups, and of the parts that were found.
    """
    if len(groups) == 1:
        return "the file has a single group"
    if (share := seams(groups, tolerance)) > SEAMS:
        return f"its {len(groups)} groups share {share:.0%} of their edges, as materials do"
    if boxes > LOOSE * found_boxes:
        held = f"{boxes:.3g} times its volume, those of found parts {found_boxes:.3g}"
        return f"cuboids of its {len(groups)} groups hold {held}"
    return ""


def seams(groups: list[Mesh], tolerance: float) -> float:
    """The share of edges at which the surface goes on in another group: open in each, not open in all together."""
    joined = join(groups)
    places = np.unique(np.round(joined.vertices / (2 * tolerance)).astype(np.int64), axis=0, return_inverse=True)[1]
    faces = places.ravel()[joined.faces]
    owner = np.repeat(np.arange(len(groups)), [len(group.faces) for group in groups])
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    real = edges[:, 0] != edges[:, 1]
    number = np.unique(edges[real], axis=0, return_inverse=True)[1].ravel()
    mine = _counts(np.stack([np.repeat(owner, 3)[real], number], axis=1))
    everyone = np.bincount(number)
    open_edges = (mine[:, 2] == 1) & (everyone[mine[:, 1]] == 2)
    return float(len(np.unique(mine[open_edges, 1])) / max(len(everyone), 1))


def _counts(pairs: Int[ndarray, "n 2"]) -> Int[ndarray, "m 3"]:
    """Each different pair and how often it comes."""
    different, count = np.unique(pairs, axis=0, return_counts=True)
    return np.column_stack([different, count])
