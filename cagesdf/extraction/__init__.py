"""From a network, a latent and a cage to a closed surface (§3.6).

The network is asked only where a cuboid is, and there only where a surface can be. Marching cubes
of its values leaves the cage by part of a cell wherever a part fills its cuboid, so the last step
is the exact intersection with the union of the cuboids: nothing lies outside.

lattice.py    the grid, and the part of it that each cuboid has
field.py      a decoder with a latent and a cage; where cuboids overlap, and where they end
asking.py     sparse or dense
joining.py    one field from the answers of all cuboids
bounding.py   what is promised of every surface
surface.py    `extract`, and `LiveSurface` for edits
"""

from cagesdf.extraction.asking import METHODS, ask_densely, ask_sparsely
from cagesdf.extraction.bounding import LOOSE, SYMMETRIES
from cagesdf.extraction.field import FIELDS, OUTSIDES, OVERLAPS, CageField, cube_field
from cagesdf.extraction.surface import Each, Extraction, LiveSurface, extract, extract_surface

__all__ = [
    "FIELDS",
    "LOOSE",
    "METHODS",
    "OUTSIDES",
    "OVERLAPS",
    "SYMMETRIES",
    "CageField",
    "Each",
    "Extraction",
    "LiveSurface",
    "ask_densely",
    "ask_sparsely",
    "cube_field",
    "extract",
    "extract_surface",
]
