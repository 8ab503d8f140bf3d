"""The codes of a shape's parts, from the shape's code and its whole cage."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from cagesdf.models.sines import sine_features

CUBOID_OCTAVES = 2  # sine features of a cuboid's numbers: where it lies, in a form that layers can tell apart


class CageTransformer(nn.Module):
    """A transformer over the cuboids of one cage, each with the shape's code; one token a part (Vaswani et al. 2017).

    The parts' order plays no part: a token knows its cuboid, not its place in a list.
    """

    def __init__(self, latent_dim: int, cuboid: int, width: int, layers: int, heads: int, code_dim: int) -> None:
        """From `latent_dim` numbers a shape and `cuboid` numbers a part to `code_dim` numbers a part."""
        super().__init__()
        self.embed = nn.Linear(latent_dim + cuboid * (1 + 2 * CUBOID_OCTAVES), width)
        self.layers = nn.ModuleList([AttentionLayer(width, heads) for _ in range(layers)])
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, code_dim))

    def forward(
        self, latent: Float[Tensor, "s d"], cuboids: Float[Tensor, "s p c"], present: Bool[Tensor, "s p"]
    ) -> Float[Tensor, "s p k"]:
        """Codes of the parts that are `present`; the others' mean nothing, and none depends on them."""
        of_shape = latent[:, None].expand(-1, cuboids.shape[1], -1)
        tokens = self.embed(torch.cat([of_shape, cuboids, sine_features(cuboids, CUBOID_OCTAVES)], dim=-1))
        for layer in self.layers:
            tokens = layer(tokens, present)
        return self.out(tokens)


class AttentionLayer(nn.Module):
    """Attention between tokens, then two linear layers for each; normalised first, added to what came in."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before = nn.LayerNorm(width)
        self.into = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.feed = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, tokens: Float[Tensor, "s p w"], present: Bool[Tensor, "s p"]) -> Float[Tensor, "s p w"]:
        """Tokens that have seen the present ones of their cage."""
        count, parts, width = tokens.shape
        given = self.into(self.before(tokens)).view(count, parts, 3, self.heads, -1)
        query, key, value = given.permute(2, 0, 3, 1, 4)
        seen = scaled_dot_product_attention(query, key, value, attn_mask=present[:, None, None])
        tokens = tokens + self.out(seen.transpose(1, 2).reshape(count, parts, width))
        return tokens + self.feed(tokens)
