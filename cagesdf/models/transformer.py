"""The codes of a shape's parts, from the shape's code and its whole cage."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import gelu, scaled_dot_product_attention

from cagesdf.errors import InputError
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
        for layer in self.layers:
            tokens = layer(tokens, latent, present)
        return self.out(self.norm(tokens, latent))


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
        self, tokens: Float[Tensor, "s p w"], latent: Float[Tensor, "s d"], present: Bool[Tensor, "s p"]
    ) -> Float[Tensor, "s p w"]:
        """Tokens that have seen the present ones of their cage."""
        count, parts, width = tokens.shape
        gates = 1 + self.gates(latent)[:, None]
        given = self.into(self.before_attention(tokens, latent)).view(count, parts, 3, self.heads, width // self.heads)
        query, key, value = given.permute(2, 0, 3, 1, 4)
        seen = scaled_dot_product_attention(query, key, value, attn_mask=present[:, None, None])
        tokens = tokens + gates[..., :width] * self.out(seen.transpose(1, 2).reshape(count, parts, width))
        return tokens + gates[..., width:] * self.second(gelu(self.first(self.before_layers(tokens, latent))))
