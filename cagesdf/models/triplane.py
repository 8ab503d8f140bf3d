"""A decoder of one part at a time: feature planes and lines in the cuboid's frame, linear in the part's code.

The code of a part comes from its shape's code and the whole cage; what it says is the shape of the part in
its cuboid. Planes hold that (EG3D's triplanes, Chan et al. 2022; here linear in a code, as POD bases are), and lines
what is finer along one axis, such as slats, rings and steps (TensoRF's vectors, Chen et al. 2022); a small network
reads them. Its answer is the distance to the part's own closed surface, so that each field is right
in all of its cuboid, whichever other cuboids reach into it; parts are joined by union (the paper's §5).
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import ClassVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from cagesdf.frames import BEYOND, LEAST_UNIT
from cagesdf.models.decoders import CUBOID, Decoder, to_unit
from cagesdf.models.film import MappingNetwork, modulated
from cagesdf.models.sines import sine_features
from cagesdf.models.transformer import BlindTransformer, CageTransformer, RelationTransformer

PLANES = tuple(combinations(range(3), 2))  # the axes of each plane
OWNERS = (0, 2, 1)  # one of them, another for each plane


class TriplaneDecoder(Decoder):
    """Distance to a part's own surface, by its code: planes and lines · MLP, times the cuboid's smallest length."""

    trains_on = "part"
    trusted = 0.5
    context: ClassVar[type[CageTransformer]] = CageTransformer  # what makes the parts' codes

    def __init__(
        self,
        width: int,
        layers: int,
        latent_dim: int,
        mapping: Sequence[int],
        octaves: int,
        code_dim: int,
        cells: int,
        channels: int,
        line_cells: int,
        line_channels: int,
        context: int,
        context_layers: int,
        heads: int,
    ) -> None:
        """Three planes of `cells`² × `channels` numbers from codes of `code_dim`; `layers` of `width` read them.

        And three lines of `line_cells` × `line_channels`, one along each axis. The transformer's are `context`,
        `context_layers` and `heads`.
        """
        super().__init__()
        self.octaves = octaves
        self.code_dim = code_dim
        self.cells = cells
        self.channels = channels
        self.line_cells = line_cells
        self.line_channels = line_channels
        self.transformer = self.context(latent_dim, CUBOID, context, context_layers, heads, code_dim)
        self.planes = nn.Linear(code_dim, 3 * channels * cells**2)
        self.lines = nn.Linear(code_dim, 3 * line_channels * line_cells)
        self.mapping = MappingNetwork(code_dim + 3, mapping, layers, width)
        inputs = 3 * (channels + line_channels) + 3 + 6 * octaves
        self.hidden = nn.ModuleList([nn.Linear(width if i else inputs, width, bias=False) for i in range(layers)])
        self.out = nn.Linear(width, 1)

    def codes(
        self, latent: Float[Tensor, "s d"], cuboids: Float[Tensor, "s p 15"], present: Bool[Tensor, "s p"]
    ) -> Float[Tensor, "s p k"]:
        """From the shape's code and the whole cage."""
        return self.transformer(latent, cuboids, present)

    def unit(self, cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, " g"]:
        """The cuboid's smallest length, at least LEAST_UNIT."""
        return cuboid[:, 12:].amin(dim=1).clamp(min=LEAST_UNIT)

    def condition(self, code: Float[Tensor, "g k"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g ..."]:
        """The planes and lines, then scales and shifts of the layers, then the unit of distances; flat."""
        film = self.mapping(torch.cat([code, cuboid[:, 12:].log()], dim=-1))
        return torch.cat([self.planes(code), self.lines(code), film.flatten(1), self.unit(cuboid)[:, None]], dim=1)

    def features(self, points: Float[Tensor, "g n 3"], cuboid: Float[Tensor, "g 15"]) -> Float[Tensor, "g n i"]:
        """The point in the cuboid's unit frame, and its sines."""
        unit = to_unit(points, cuboid)
        return torch.cat([unit, sine_features(unit, self.octaves)], dim=-1)

    def evaluate(
        self, features: Float[Tensor, "g n i"], condition: Float[Tensor, "g ..."], compute_dtype: torch.dtype
    ) -> Float[Tensor, "g n"]:
        """Signed distance of each point."""
        planes, lines, scales, shifts, unit = self._split(condition)
        given = torch.cat([self.read(planes, lines, features[..., :3]), features], dim=-1)
        weights = [layer.get_parameter("weight") for layer in self.hidden]
        return self.out(modulated(given, scales, shifts, 0, weights, compute_dtype))[..., 0] * unit

    def on_lattice(
        self, condition: Float[Tensor, "1 ..."], cuboid: Float[Tensor, "1 15"], axes: Sequence[Float[Tensor, " _"]]
    ) -> Callable[[Int[Tensor, "n 3"]], Float[Tensor, " n"]]:
        """As in `Decoder`: the first layer's product with all that it is given of a node is a sum of three rows.

        They come from three tables over pairs of axes. A table has the share of its plane's features, and of the line,
        the coordinate and its sines of one axis. Scales are multiplied into the weights.
        """
        planes, lines, scales, shifts, unit = self._split(condition)
        images = planes.view(3, self.channels, self.cells, self.cells)
        rows = lines.view(3, self.line_channels, 1, self.line_cells)
        weights = [scale[:, None] * layer.get_parameter("weight") for scale, layer in zip(scales[0], self.hidden)]
        first_line = 3 * self.channels
        first_coordinate = first_line + 3 * self.line_channels
        first_sine = first_coordinate + 3
        tables = list[Tensor]()
        for plane, ((a, b), owner) in enumerate(zip(PLANES, OWNERS)):
            grid = torch.stack(torch.meshgrid(axes[a], axes[b], indexing="ij"), dim=-1)
            coordinate = grid[..., (owner == b) : (owner == b) + 1]
            of_plane = _bilinear(images[plane : plane + 1], grid[None])[0].permute(1, 2, 0)
            of_line = _linear(rows[owner : owner + 1], axes[owner][None])[0].T
            of_line = of_line[None] if owner == b else of_line[:, None]
            features = torch.cat(
                [of_plane, of_line.expand(*grid.shape[:2], -1), coordinate, sine_features(coordinate, self.octaves)],
                dim=-1,
            ).flatten(0, 1)
            columns = [*range(plane * self.channels, (plane + 1) * self.channels)]
            columns += range(first_line + owner * self.line_channels, first_line + (owner + 1) * self.line_channels)
            columns += [first_coordinate + owner, *range(first_sine + owner, first_sine + 6 * self.octaves, 3)]
            tables.append(features @ weights[0][:, columns].T)
        tables[0] += shifts[0, 0]
        out, bias = self.out.weight[0] * unit[0], self.out.bias * unit[0]

        def at_nodes(nodes: Int[Tensor, "n 3"]) -> Float[Tensor, " n"]:
            places = [nodes[:, a] * len(axes[b]) + nodes[:, b] for a, b in PLANES]
            one, two, three = (table.index_select(0, place) for table, place in zip(tables, places))
            hidden = one.add_(two).add_(three).relu_()
            for weight, shift in zip(weights[1:], shifts[0, 1:]):
                hidden = torch.addmm(shift, hidden, weight.T).relu_()
            return torch.addmv(bias.expand(len(hidden)), hidden, out)

        return at_nodes

    def read(
        self, planes: Float[Tensor, "g f"], lines: Float[Tensor, "g e"], unit: Float[Tensor, "g n 3"]
    ) -> Float[Tensor, "g n c"]:
        """Features of planes and lines at points of the unit frame, linear between cells; beyond, the border's."""
        count, points = unit.shape[:2]
        places = torch.stack([unit[..., axes] for axes in PLANES], dim=1).view(3 * count, 1, points, 2)
        of_planes = _bilinear(planes.reshape(3 * count, self.channels, self.cells, self.cells), places)
        coordinates = unit.transpose(1, 2).reshape(3 * count, points)
        of_lines = _linear(lines.reshape(3 * count, self.line_channels, 1, self.line_cells), coordinates)
        both = of_planes.view(count, 3 * self.channels, points), of_lines.view(count, 3 * self.line_channels, points)
        return torch.cat(both, dim=1).transpose(1, 2)

    def _split(self, condition: Float[Tensor, "g ..."]) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Planes, lines, scales and shifts by layer, and unit, of groups."""
        sizes = [self.planes.out_features, self.lines.out_features]
        sizes += [condition.shape[1] - sum(sizes) - 1, 1]
        # Slices would have a gradient of the whole, mostly zeros.
        planes, lines, film, unit = condition.split(sizes, dim=1)
        scales, shifts = film.view(len(film), len(self.hidden), 2, -1).unbind(dim=2)
        return planes, lines, 1 + scales, shifts, unit


class PlainTriplaneDecoder(TriplaneDecoder):
    """The same with codes of parts that don't see each other."""

    context = BlindTransformer


class RelationTriplaneDecoder(TriplaneDecoder):
    """The same with attention that knows how cuboids relate."""

    context = RelationTransformer


def _bilinear(images: Float[Tensor, "k c h w"], places: Float[Tensor, "k a b 2"]) -> Float[Tensor, "k c a b"]:
    """Feature planes, or lines as planes of one row, at places of the unit frame."""
    return grid_sample(images, places * (2 / (1 + 2 * BEYOND)), padding_mode="border", align_corners=True)


def _linear(lines: Float[Tensor, "k c 1 w"], places: Float[Tensor, "k n"]) -> Float[Tensor, "k c n"]:
    """Feature lines at coordinates of the unit frame."""
    return _bilinear(lines, torch.stack([places, torch.zeros_like(places)], dim=-1)[:, None])[:, :, 0]
