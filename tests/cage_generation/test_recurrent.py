"""The recurrent unit is torch's, and so is its derivative."""

import torch
from torch import nn
from torch.nn.utils.rnn import PackedSequence

from cagesdf.cage_generation.recurrent import PackedGRU

RUNNING = (5, 5, 4, 2, 1)
WIDTH = 6


def both() -> tuple[PackedGRU, nn.GRU]:
    torch.manual_seed(0)
    ours, theirs = PackedGRU(WIDTH).double(), nn.GRU(WIDTH, WIDTH).double()
    weights = {"weight_ih_l0": ours.given.weight, "bias_ih_l0": ours.given.bias}
    weights |= {"weight_hh_l0": ours.kept.weight, "bias_hh_l0": ours.kept.bias}
    theirs.load_state_dict({name: tensor.detach() for name, tensor in weights.items()})
    return ours, theirs


def test_states_and_all_gradients_are_torchs_own() -> None:
    ours, theirs = both()
    weights = torch.randn(sum(RUNNING), WIDTH).double()
    grads = []
    for network in (ours, theirs):
        torch.manual_seed(1)
        lines = torch.randn(sum(RUNNING), WIDTH).double().requires_grad_()
        start = torch.randn(RUNNING[0], WIDTH).double().requires_grad_()
        if network is ours:
            states = ours(lines, RUNNING, start)
        else:
            states = theirs(PackedSequence(lines, torch.tensor(RUNNING)), start[None])[0].data
        (states * weights).sum().backward()
        grads.append([states, lines.grad, start.grad, *[parameter.grad for parameter in network.parameters()]])
    # nn.GRU lists both weights before both biases.
    order = [0, 1, 2, 3, 5, 4, 6]
    for i, theirs_at in enumerate(order):
        torch.testing.assert_close(grads[0][i], grads[1][theirs_at])


def test_the_derivative_is_that_of_differences() -> None:
    network, _ = both()
    lines = torch.randn(sum(RUNNING), WIDTH).double().requires_grad_()
    start = torch.randn(RUNNING[0], WIDTH).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda x, h: network(x, RUNNING, h), (lines, start))


def test_step_by_step_is_all_at_once() -> None:
    network, _ = both()
    lines, states = torch.randn(sum(RUNNING), WIDTH).double(), torch.randn(RUNNING[0], WIDTH).double()
    at_once, begin = network(lines, RUNNING, states), 0
    for count in RUNNING:
        states = network.step(lines[begin : begin + count], states[:count])
        torch.testing.assert_close(states, at_once[begin : begin + count])
        begin += count
