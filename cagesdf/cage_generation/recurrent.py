"""A gated recurrent unit over packed sequences [Cho et al. 2014], its derivative written by hand.

Torch's own does each step's products of the derivative by itself, and fills a matrix of all steps with
zeros for each; with short sequences that is most of the time. Here the products with weights that are
the same in all steps are done at once, before the first step and after the last.
"""

from itertools import accumulate, pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

Rows = list[tuple[int, int]]  # of each step: where its lines begin and end


class PackedGRU(nn.Module):
    """Initialised as torch's `nn.GRU`, with its formula and the order reset, update, new."""

    def __init__(self, width: int) -> None:
        super().__init__()
        bound = width**-0.5
        self.given = nn.Linear(width, 3 * width)
        self.kept = nn.Linear(width, 3 * width)
        for parameter in self.parameters():
            nn.init.uniform_(parameter, -bound, bound)

    def forward(
        self, lines: Float[Tensor, "n w"], running: tuple[int, ...], start: Float[Tensor, "b w"]
    ) -> Float[Tensor, "n w"]:
        """The state after each line.

        Lines are packed: the first ones of all b sequences, longest sequence first, then the second ones
        of those that have one. `running` says how many sequences have a line of each number, b first.
        """
        rows = list(pairwise(accumulate(running, initial=0)))
        return _Steps.apply(self.given(lines), start, self.kept.weight, self.kept.bias, rows)

    def step(self, lines: Float[Tensor, "b w"], states: Float[Tensor, "b w"]) -> Float[Tensor, "b w"]:
        """One line of each sequence."""
        return self(lines, (len(lines),), states)


class _Steps(torch.autograd.Function):
    """The states after each line, from the lines' share of the gates and the first states."""

    @staticmethod
    def forward(ctx: Any, gates: Tensor, start: Tensor, weight: Tensor, bias: Tensor, rows: Rows) -> Tensor:
        width = start.shape[1]
        gates = gates.clone()  # becomes reset, update and new
        states, kept_new = gates.new_empty(len(gates), width), gates.new_empty(len(gates), width)
        before = start
        for begin, end in rows:
            before = before[: end - begin]
            kept = torch.addmm(bias, before, weight.T)
            gate, kept_new[begin:end] = gates[begin:end], kept[:, 2 * width :]
            reset_update = gate[:, : 2 * width].add_(kept[:, : 2 * width]).sigmoid_()
            new = gate[:, 2 * width :].addcmul_(reset_update[:, :width], kept[:, 2 * width :]).tanh_()
            before = torch.lerp(new, before, reset_update[:, width:], out=states[begin:end])
        ctx.save_for_backward(gates, kept_new, states, start, weight)
        ctx.rows = rows
        return states

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, None]:
        gates, kept_new, states, start, weight = ctx.saved_tensors
        (grad,) = grads
        # The state before each line: the first states, then those of the sequences that go on.
        before = torch.cat([start, *[states[b : b + n - e] for (b, _), (e, n) in pairwise(ctx.rows)]])
        reset, update, new = gates.chunk(3, dim=1)
        by_state = torch.stack([  # of reset, update and new before their nonlinearities, by the state after
            (1 - update) * (1 - new**2) * kept_new * reset * (1 - reset),
            (before - new) * update * (1 - update),
            (1 - update) * (1 - new**2),
        ], dim=1)  # fmt: skip
        by_kept = torch.stack([by_state[:, 0], by_state[:, 1], by_state[:, 2] * reset], dim=1)
        total = grad.clone()
        later = torch.zeros_like(start)
        for begin, end in reversed(ctx.rows):
            count = end - begin
            gradient = total[begin:end].add_(later[:count])
            through = (by_kept[begin:end] * gradient[:, None]).flatten(1)
            later[:count] = torch.addmm(gradient * update[begin:end], through, weight)
        grad_gates = (by_state * total[:, None]).flatten(1)
        grad_kept = (by_kept * total[:, None]).flatten(1)
        return grad_gates, later, grad_kept.T @ before, grad_kept.sum(dim=0), None
