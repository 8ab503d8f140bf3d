"""Closed solids of parts and their union, from a network, the parts' codes and a cage (§3.6).

The network is evaluated on a lattice of each cuboid, along its own axes, and there only where a surface
can be. Points beyond its faces are outside, so that the solid ends on them exactly: parts that fill their cuboids have
flat faces and sharp edges, and nothing lies outside. The shape is the exact union of its parts.

lattice.py    the points of a cuboid
field.py      a decoder with a cage and the codes of its parts
values.py     a network's values there, everywhere or only where the surface can be
table.py      triangles of a cell for each sign of its corners
marching.py   a surface from values, its vertices moved to the zero set
merging.py    fewer vertices where it is nearly flat
part.py       the closed solid of a part
promises.py   invariants of every surface
owners.py     whose surface each face is
surface.py    `extract`, and `LiveSurface` for edits
"""

from cagesdf.extraction.field import CUBE, CageField, field_of
from cagesdf.extraction.marching import NOTHING
from cagesdf.extraction.owners import face_owners
from cagesdf.extraction.part import Part
from cagesdf.extraction.promises import LOOSE, SYMMETRIES
from cagesdf.extraction.surface import (
    Each,
    Extraction,
    LiveSurface,
    extract,
    extract_surface,
)
from cagesdf.extraction.thinness import PREVIEW, USUAL, Fineness
from cagesdf.extraction.values import METHODS, dense_values, sparse_values

__all__ = [
    "CUBE",
    "LOOSE",
    "METHODS",
    "NOTHING",
    "PREVIEW",
    "SYMMETRIES",
    "USUAL",
    "CageField",
    "Each",
    "Extraction",
    "Fineness",
    "LiveSurface",
    "Part",
    "dense_values",
    "extract",
    "extract_surface",
    "face_owners",
    "field_of",
    "sparse_values",
]
