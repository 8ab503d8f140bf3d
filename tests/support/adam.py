"""The paper's appendix to the letter: Adam on the fitting loss of a program. Slow, and obvious."""

import numpy as np
import torch

from cagesdf.cage_fitting.programs import match_axes
from cagesdf.cuboid import Cage
from cagesdf.errors import ProgramError
from cagesdf.structure.executor import differentiate, execute
from cagesdf.structure.program import AssemblyProgram


def loss_of(vectors: torch.Tensor, boxes: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """The loss of leaves (p 15), minimum-volume boxes (p 15) and surface points (p n 3)."""
    centre, axes, size = vectors[:, None, :3], vectors[:, 3:12].reshape(-1, 3, 3), vectors[:, None, 12:]
    beyond = ((points - centre) @ axes.transpose(1, 2)).abs() - size / 2
    # The norm's slope at 0 is NaN in torch: such points are given none.
    squares = beyond.clamp(min=0).square().sum(dim=2)
    outside = torch.where(squares > 0, squares.clamp(min=1e-30).sqrt(), 0.0)
    distance = outside + beyond.amax(dim=2).clamp(max=0)
    return (distance + 0.01).clamp(min=0).mean() + (vectors - boxes).abs().sum(dim=1).mean()


def fit_by_adam(
    program: AssemblyProgram, boxes: Cage, points: np.ndarray, steps: int = 2000
) -> tuple[AssemblyProgram, list[float]]:
    """The program after so many steps, and the loss at each and after the last. Lengths are kept positive."""
    targets = torch.tensor(match_axes(boxes, execute(program)).vectors())
    surface = torch.tensor(points)
    parameters = torch.tensor(program.parameters())
    optimiser = torch.optim.Adam([parameters], lr=1e-3)
    losses: list[float] = []
    for _ in range(steps):
        cage, jacobian = differentiate(program)
        vectors = torch.tensor(cage.vectors(), requires_grad=True)
        loss = loss_of(vectors, targets, surface)
        losses.append(loss.item())
        loss.backward()
        parameters.grad = torch.einsum("pi,pit->t", vectors.grad, torch.tensor(jacobian))
        before = parameters.clone()
        optimiser.step()
        try:
            program = program.with_parameters(parameters.numpy())
        except ProgramError:  # a length below zero: each parameter that can't be what it should stays
            parameters.copy_(torch.where(parameters > 1e-3, parameters, before))
            program = program.with_parameters(parameters.numpy())
    return program, [*losses, float(loss_of(torch.tensor(execute(program).vectors()), targets, surface))]
