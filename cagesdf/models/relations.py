"""How the cuboids of a cage relate to each other, read off the cuboids themselves.

So relations hold for shapes without labels or structure, and follow edits.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

RELATIONS = ("self", "attached", "mirrored", "repeated")
CONTACT = 0.01  # canonical units; cuboids with a smaller gap are attached
EQUAL = 0.01  # canonical units; cuboids are equal if their lengths along any direction differ by less, about


def relations(cuboids: Float[Tensor, "s p 15"]) -> Bool[Tensor, "s p p 4"]:
    """Which of RELATIONS each cuboid has to each other one of its cage; the cuboids are canonical.

    Attached: no plane along a face of either keeps them apart by CONTACT. Mirrored: one is the other's reflection in
    the plane halfway between their centres. Repeated: one is the other moved. A pair can have several. The order of a
    cuboid's axes and their signs play no part.
    """
    centre, axes, size = cuboids[..., :3], cuboids[..., 3:12].unflatten(-1, (3, 3)), cuboids[..., 12:]
    itself = torch.eye(cuboids.shape[1], dtype=torch.bool, device=cuboids.device).expand(len(cuboids), -1, -1)
    between = centre[:, None] - centre[:, :, None]  # from the first to the second
    gap = _gap(between, axes, size)
    # Lengths along directions as one matrix, which knows no order of axes.
    extents = axes.mT @ (size[..., None] * axes)
    first, second = extents[:, :, None], extents[:, None]
    length = between.norm(dim=-1, keepdim=True)
    normal = between / length.clamp(min=1e-9)
    reflection = torch.eye(3, device=cuboids.device) - 2 * normal[..., None] * normal[..., None, :]
    mirrored = _equal(reflection @ first @ reflection, second) & (length[..., 0] > CONTACT)
    attached = torch.maximum(gap, gap.mT) < CONTACT
    return torch.stack([itself, attached & ~itself, mirrored & ~itself, _equal(first, second) & ~itself], dim=-1)


def _gap(
    between: Float[Tensor, "s p p 3"], axes: Float[Tensor, "s p 3 3"], size: Float[Tensor, "s p 3"]
) -> Float[Tensor, "s p p"]:
    """How far the second cuboid is beyond a face of the first; negative if it is beyond none."""
    distance = (axes[:, :, None] @ between[..., None])[..., 0].abs()
    along = (axes[:, :, None] @ axes[:, None].mT).abs()  # of the second's axes, along the first's
    reach = (along @ size[:, None, :, :, None])[..., 0]
    return (distance - (reach + size[:, :, None]) / 2).amax(dim=-1)


def _equal(first: Float[Tensor, "*#b 3 3"], second: Float[Tensor, "*#b 3 3"]) -> Bool[Tensor, "*#b"]:
    return (first - second).flatten(-2).norm(dim=-1) < EQUAL
