"""Several processes that train one network together, as `torchrun` starts them.

Every rank holds the decoder and the latents, draws the same global batch and computes the gradient
of its share of the groups. Gradients are summed over ranks, the latent table's as one dense matrix,
so that a shape whose groups went to several ranks is still updated once, and on every rank alike.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import Tensor

Value = TypeVar("Value")


@dataclass(frozen=True)
class Ranks:
    """This process among those that train together; alone it is the first of one."""

    rank: int
    size: int

    @property
    def first(self) -> bool:
        """Whether this process writes files."""
        return self.rank == 0

    def share(self, groups: int) -> range:
        """Indices of this rank's groups, of `groups`: a run of them, empty where ranks are more than groups."""
        return range(groups * self.rank // self.size, groups * (self.rank + 1) // self.size)

    def all_reduce(self, tensors: Sequence[Tensor]) -> None:
        """Put the sums over all ranks into `tensors`, the same bits on every rank."""
        if self.size == 1:
            return
        flat = torch.cat([tensor.flatten() for tensor in tensors])
        dist.all_reduce(flat)
        sums = flat.split([tensor.numel() for tensor in tensors])
        for tensor, total in zip(tensors, sums, strict=True):
            tensor.copy_(total.view_as(tensor))

    def broadcast(self, thing: Value) -> Value:
        """The first rank's `thing`, its tensors on the CPU; those of the others are ignored."""
        if self.size == 1:
            return thing
        things = [thing]
        dist.broadcast_object_list(things, src=0)
        return things[0]

    def barrier(self) -> None:
        """Wait until all ranks have called it."""
        if self.size > 1:
            dist.barrier()


ALONE = Ranks(0, 1)


@contextmanager
def joined_ranks() -> Iterator[Ranks]:
    """The ranks that `torchrun` started, or this process alone; each takes the GPU of its place on its machine."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield ALONE
        return
    cuda = torch.cuda.is_available() and os.environ.get("CAGESDF_DEVICE") != "cpu"
    if cuda:
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    dist.init_process_group("nccl" if cuda else "gloo")
    try:
        yield Ranks(dist.get_rank(), dist.get_world_size())
    finally:
        dist.destroy_process_group()
