"""The codes of a shape's parts, from the shape's code and its whole cage."""

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor, nn
from torch.nn.functional import gelu, scaled_dot_product_attention

from cagesdf.errors import InputError
from cagesdf.models.relations import RELATIONS, relations
from cagesdf.models.sines import sine_features

CUBOID_OCTAVES = 2  # sine features of a cuboid's numbers: where it lies, in a form that layers can tell apart


class CageTransformer(nn.Module):
    """A transformer over the cuboids of one cage, a token a part, which the shape's code modulates.

    Attention as in Vaswani et al. 2017; scales and shifts of normalised tokens from the code as in DiT (Peebles & Xie
    2023): with the code in the tokens alone, surfaces were as good after half as long again. The parts' order plays
    no part: a token knows its cuboid, not its place in a list.
    """

    def __init__(self, latent_dim: int, cuboid: int, width: int, layers: int, heads: int, code_dim: int) -> None:
        """From `latent_dim` numbers a shape and `cuboid` numbers a part to `code_dim` numbers a part.

        Raises InputError if `heads` don't share `width` evenly.
        """
        super().__init__()
        if width % heads:
            raise InputError(f"context: {width} units don't share out evenly among {heads} heads; wanted a multiple")
        self.embed = nn.Linear(latent_dim + cuboid * (1 + 2 * CUBOID_OCTAVES), width)
        self.layers = nn.ModuleList([ModulatedAttention(width, heads, latent_dim) for _ in range(layers)])
        self.norm = ModulatedNorm(width, latent_dim)
        self.out = nn.Linear(width, code_dim)

    def forward(
        self, latent: Float[Tensor, "s d"], cuboids: Float[Tensor, "s p c"], present: Bool[Tensor, "s p"]
    ) -> Float[Tensor, "s p k"]:
        """Codes of the parts that are `present`; the others' mean nothing, and none depends on them."""
        of_shape = latent[:, None].expand(-1, cuboids.shape[1], -1)
        tokens = self.embed(torch.cat([of_shape, cuboids, sine_features(cuboids, CUBOID_OCTAVES)], dim=-1))
        seen = self.seen(cuboids, present)
        for layer in self.layers:
            tokens = layer(tokens, latent, seen)
        return self.out(self.norm(tokens, latent))

    def seen(self, cuboids: Float[Tensor, "s p c"], present: Bool[Tensor, "s p"]) -> Shaped[Tensor, "#s #h #p p"]:
        """Attention mask by head, or a bias that is added before the softmax. Here each token sees all others."""
        return present[:, None, None]


class BlindTransformer(CageTransformer):
    """Tokens that don't see each other: a part's code follows from its cuboid and the shape's code alone."""

    def seen(self, cuboids: Float[Tensor, "s p c"], present: Bool[Tensor, "s p"]) -> Shaped[Tensor, "#s #h #p p"]:
        """Each itself."""
        return torch.eye(cuboids.shape[1], dtype=torch.bool, device=cuboids.device)[None, None]


class RelationTransformer(CageTransformer):
    """Attention that knows how cuboids relate (`relations`): a bias for each kind and head, as Graphormer's edges have.

    Ying et al. 2021. The biases are zero as training starts.
    """

    def __init__(self, latent_dim: int, cuboid: int, width: int, layers: int, heads: int, code_dim: int) -> None:
        """As `CageTransformer`."""
        super().__init__(latent_dim, cuboid, width, layers, heads, code_dim)
        self.biases = nn.Linear(len(RELATIONS), heads, bias=False)
        nn.init.zeros_(self.biases.weight)

    def seen(self, cuboids: Float[Tensor, "s p c"], present: Bool[Tensor, "s p"]) -> Shaped[Tensor, "#s #h #p p"]:
        """Biases by relation."""
        biases = self.biases(relations(cuboids).to(cuboids.dtype)).permute(0, 3, 1, 2)
        return biases.masked_fill(~present[:, None, None], -torch.inf)


class ModulatedNorm(nn.Module):
    """Layer normalisation whose scale and shift follow from the shape's code."""

    def __init__(self, width: int, latent_dim: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.modulation = nn.Linear(latent_dim, 2 * width)

    def forward(self, tokens: Float[Tensor, "s p w"], latent: Float[Tensor, "s d"]) -> Float[Tensor, "s p w"]:
        """Normalised tokens, scaled and shifted; a scale is near 1 as training starts."""
        scale, shift = self.modulation(latent)[:, None].chunk(2, dim=-1)
        return self.norm(tokens) * (1 + scale) + shift


class ModulatedAttention(nn.Module):
    """Attention between tokens, then two linear layers for each, both added to what came in."""

    def __init__(self, width: int, heads: int, latent_dim: int) -> None:
        super().__init__()
        self.heads = heads
        self.before_attention = ModulatedNorm(width, latent_dim)
        self.into = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.before_layers = ModulatedNorm(width, latent_dim)
        self.first = nn.Linear(width, 2 * width)
        self.second = nn.Linear(2 * width, width)
        self.gates = nn.Linear(latent_dim, 2 * width)

    def forward(
        self, tokens: Float[Tensor, "s p w"], latent: Float[Tensor, "s d"], seen: Shaped[Tensor, "#s #h #p p"]
    ) -> Float[Tensor, "s p w"]:
        """Tokens that have looked at others of their cage: those of a mask, or all with biases."""
        count, parts, width = tokens.shape
        gates = 1 + self.gates(latent)[:, None]
        given = self.into(self.before_attention(tokens, latent)).view(count, parts, 3, self.heads, width // self.heads)
        query, key, value = given.permute(2, 0, 3, 1, 4)
        read = scaled_dot_product_attention(query, key, value, attn_mask=seen)
        tokens = tokens + gates[..., :width] * self.out(read.transpose(1, 2).reshape(count, parts, width))
        return tokens + gates[..., width:] * self.second(gelu(self.first(self.before_layers(tokens, latent))))
