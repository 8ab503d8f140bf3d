"""Fit a program's parameters so that its leaves bound their parts (§3.2 and the paper's appendix).

The appendix's loss of a program with leaves c, in the program's frame and unit:

    mean over leaves and points of max(signed distance + 0.01, 0)
    + mean over leaves of |c - ĉ|₁, over 15 numbers each: centre, axes by rows, full lengths

ĉ is the part's minimum-volume box. Its axes are named after the leaf's as the program is given
(`match_axes`), so that the order and the signs in which a box's axes happen to come don't matter.

The loss is a sum of absolute values of what is nearly linear in the parameters, and little else, so it
is minimised by sequential linear programming: each step minimises the loss of the leaves as their
derivatives extrapolate them, no parameter changing by more than a radius; steps that don't lower the
loss itself shrink the radius. Before that they are tried once more with the leaves' curvature added that
they met (a second-order correction [Fletcher 1982]): near the minimum the loss is all edges, and a step along
one of them falls off it. At the minimum most leaves agree with their boxes in most numbers exactly.

The loss keeps the leaves near their parts but does not make them bound them: `bound_program` does, by
the same steps, with a price on what sticks out in place of the points' term.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csc_array

from cagesdf.cage_fitting.hinge import ROOM, Hinge
from cagesdf.cuboid import Cage
from cagesdf.errors import ProgramError
from cagesdf.structure.executor import differentiate, execute
from cagesdf.structure.program import AssemblyProgram, Attach, Declare, Squeeze, Translate

MIN_LENGTH = 1e-3  # of the lengths that a program declares, its unit
RADII = (0.1, 0.02)  # of the first step: executing is not continuous, and the loss has many minima
MAX_RADIUS = 0.5
LEAST_RADIUS = 1e-6
POOR = 0.3  # share of the expected gain: after less a step is bent, and the radius shrinks
CLIFF = 2e-3  # a shorter step that raises the loss by much more than it should lower it meets a discontinuity
JUMPS = 3  # across one, at most
STEPS = 60  # at most
GAIN = 3e-4  # a smaller share of the loss is not worth another step
REACHED = 1e-5  # above the loss of the boxes themselves: nearer to it nothing is worth another step
DAMPING = 1e-4  # price of changing a parameter by one: those without effect stay as they are
PRICE = 100.0  # of each unit by which a part sticks out; more than any change of a leaf by so much may cost
STILL = 1e-9  # slopes below this are none
TILTS = np.array([[0, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]]) * 0.1  # in which a face's farthest vertices are sought


def match_axes(boxes: Cage, cage: Cage) -> Cage:
    """The boxes with their axes named to be as near as possible to those of the cage's cuboids."""
    return Cage.of({part_id: boxes[part_id].nearest_to(cuboid.axes) for part_id, cuboid in cage.cuboids().items()})


def fitting_loss(cage: Cage, boxes: Cage, points: Float[ndarray, "p n 3"]) -> float:
    """The appendix's loss of a cage, in the unit of all three, which is the program's.

    `boxes` are the parts' minimum-volume boxes as `match_axes` names them; `points` are n on the surface of each part.
    """
    hinges = [
        np.maximum(Cage.of({part_id: cuboid}).signed_distance(surface) + ROOM, 0).mean()
        for (part_id, cuboid), surface in zip(cage.cuboids().items(), points, strict=True)
    ]
    return float(np.mean(hinges) + np.abs(cage.vectors() - boxes.vectors()).sum() / len(cage))


def fit_program(program: AssemblyProgram, boxes: Cage, points: Float[ndarray, "p n 3"]) -> AssemblyProgram:
    """The program with the parameters that minimise `fitting_loss`.

    `boxes` are the parts' minimum-volume boxes, `points` are n on the surface of each part, both in
    the program's frame and in the order of its leaves. Raises ProgramError if the program as given
    doesn't execute.
    """
    return _fitted(program, boxes, _Sticking(Hinge(points)))


def bound_program(program: AssemblyProgram, boxes: Cage, points: Sequence[Float[ndarray, "_ 3"]]) -> AssemblyProgram:
    """The program changed until its leaves bound `points`, given for each leaf; vertices of the convex hull suffice.

    Among such parameters it seeks those that keep the leaves near `boxes` (as in `fit_program`).
    If there are none, the points stick out as little as possible. Raises ProgramError if the
    program as given doesn't execute.
    """
    return _fitted(program, boxes, _Overshoot(points))


@dataclass(frozen=True, eq=False)
class _Model:
    """A penalty near given cuboids: value + slope · change, or with cuts the sum over parts of the largest cut.

    A cut counts from 0 up: max(0, cuts of the part: height + face · change).
    """

    value: float
    slope: Float[ndarray, "p 15"]
    parts: Int[ndarray, " c"]  # that each cut belongs to
    faces: Float[ndarray, "c 15"]  # by the part's numbers
    heights: Float[ndarray, " c"]


# A loss of cuboids (`Cage.vectors`) that is added to their distance to the boxes.
_Penalty = Callable[[Float[ndarray, "p 15"]], _Model]


class _Sticking:
    """The points' part of the loss, extrapolated by its slope."""

    def __init__(self, hinge: Hinge) -> None:
        self._hinge = hinge

    def __call__(self, vectors: Float[ndarray, "p 15"]) -> _Model:
        value, slope = self._hinge(vectors)
        return _Model(value, slope, np.zeros(0, int), np.zeros((0, 15)), np.zeros(0))


class _Overshoot:
    """PRICE times the largest distance of each part's points beyond a face's plane."""

    def __init__(self, points: Sequence[Float[ndarray, "_ 3"]]) -> None:
        self._points = points

    def __call__(self, vectors: Float[ndarray, "p 15"]) -> _Model:
        cuts = [_cuts(points, vector) for points, vector in zip(self._points, vectors, strict=True)]
        value = sum(max(0.0, float(heights.max())) for _, heights in cuts)
        return _Model(
            PRICE * value,
            np.zeros(vectors.shape),
            np.repeat(np.arange(len(cuts)), [len(heights) for _, heights in cuts]),
            PRICE * np.concatenate([faces for faces, _ in cuts]),
            PRICE * np.concatenate([heights for _, heights in cuts]),
        )


def _cuts(points: Float[ndarray, "n 3"], vector: Float[ndarray, " 15"]) -> tuple[ndarray, ndarray]:
    """Slopes and heights over a cuboid's faces of the points that are farthest, now or once it has turned a little."""
    axes, half = vector[3:12].reshape(3, 3), vector[12:] / 2
    offsets = points - vector[:3]
    along = offsets @ axes.T
    faces, heights = [], []
    for k in range(3):
        others = along[:, [(k + 1) % 3, (k + 2) % 3]] @ TILTS.T
        for side in (-1.0, 1.0):
            farthest = np.unique((side * along[:, k, None] + others).argmax(axis=0))
            face = np.zeros((len(farthest), 15))
            face[:, :3] = -side * axes[k]
            face[:, 3 + 3 * k : 6 + 3 * k] = side * offsets[farthest]
            face[:, 12 + k] = -0.5
            faces.append(face)
            heights.append(side * along[farthest, k] - half[k])
    return np.concatenate(faces), np.concatenate(heights)


@dataclass(frozen=True, eq=False)
class _State:
    """A program, and its executed leaves."""

    program: AssemblyProgram
    vectors: Float[ndarray, "p 15"]  # its leaves
    penalty: _Model
    loss: float


@dataclass(frozen=True, eq=False)
class _Problem:
    """The mean L1 distance of a program's leaves to boxes, plus a penalty, to be minimised over its parameters.

    Executing is not continuous: a corner that leaves its neighbour makes a cuboid grow. Where a descent ends
    at such a cliff, it is tried again from the other side.

    No leaves have a lower loss than the boxes themselves: a penalty is no steeper than the distance, or 0 there.
    Many programs can execute to them, and nothing is sought once that is found.
    """

    boxes: Float[ndarray, "p 15"]
    penalty: _Penalty
    lowest: Float[ndarray, " t"]  # of each parameter

    def minimise(self, program: AssemblyProgram) -> _State:
        """The best state found from the starting program."""
        start = best = self._state(program)
        enough = self.penalty(self.boxes).value + REACHED
        for radius in RADII:
            beyond: _State | None = start
            for _ in range(1 + JUMPS):
                if beyond is None or best.loss < enough:
                    break
                least, beyond = self._descend(beyond, radius, enough)
                best = min(best, least, key=lambda state: state.loss)
            if best is start:  # nor do shorter steps lead from there
                break
        return best

    def _state(self, program: AssemblyProgram) -> _State:
        vectors = execute(program).vectors()
        model = self.penalty(vectors)
        return _State(program, vectors, model, float(np.abs(vectors - self.boxes).sum() / len(vectors) + model.value))

    def _trial(self, state: _State, step: Float[ndarray, " t"]) -> _State | None:
        """The state after a step; None if there the program doesn't execute, or to cuboids without size."""
        try:
            after = self._state(state.program.with_parameters(state.program.parameters() + step))
        except ProgramError:
            return None
        return after if after.vectors[:, 12:].min() > 0 else None

    def _bent(
        self,
        state: _State,
        jacobian: Float[ndarray, "p 15 t"],
        step: Float[ndarray, " t"],
        trial: _State,
        radius: float,
    ) -> _State | None:
        """The state after a step that is corrected by the leaves' curvature on the way to `trial`."""
        bend = trial.vectors - (state.vectors + jacobian @ step)
        corrected, _ = self._step(replace(state, vectors=state.vectors + bend), jacobian, radius)
        return self._trial(state, corrected)

    def _descend(self, state: _State, radius: float, enough: float) -> tuple[_State, _State | None]:
        """Lower the loss step by step until it is enough. If a cliff ends that, also the state beyond it.

        No parameter changes by more than `radius` in the first step.
        """
        jacobian = _jacobian(state.program)
        for _ in range(STEPS):
            if jacobian is None:
                break
            step, expected = self._step(state, jacobian, radius)
            length = float(np.abs(step).max())
            if expected < GAIN * state.loss or length < LEAST_RADIUS:
                break
            trial = self._trial(state, step)
            gain = state.loss - trial.loss if trial else -np.inf
            if trial and gain < POOR * expected:
                bent = self._bent(state, jacobian, step, trial, radius)
                if bent and bent.loss < trial.loss:
                    trial, gain = bent, state.loss - bent.loss
            if trial and gain > 0.1 * expected:
                state = trial
                if state.loss < enough:
                    break
                jacobian = _jacobian(state.program)
            elif trial and length < CLIFF and gain < -5 * expected:
                return state, trial
            if gain > 0.75 * expected:
                radius = min(max(radius, 2 * length), MAX_RADIUS)
            elif gain < POOR * expected:
                radius = length / (4 if gain < 0.1 * expected else 2)
        return state, None

    def _step(
        self, state: _State, jacobian: Float[ndarray, "p 15 t"], radius: float
    ) -> tuple[Float[ndarray, " t"], float]:
        """The step that minimises the extrapolated loss within the radius, and by how much it lowers that.

        Variables of the linear program: increase and decrease of each parameter; excess and deficit of each
        number of each leaf over its box's; each part's penalty.
        """
        p, _, t = jacobian.shape
        model, slopes = state.penalty, jacobian.reshape(-1, t)
        moving = np.abs(slopes).max(axis=1) > STILL
        slopes, residual = slopes[moving], (state.vectors - self.boxes).ravel()[moving]
        m, c = len(residual), len(model.heights)
        cuts = np.einsum("ci,cit->ct", model.faces, jacobian[model.parts])
        drift = np.einsum("pi,pit->t", model.slope, jacobian)

        cost = np.concatenate([DAMPING + drift, DAMPING - drift, np.full(2 * m, 1 / p), np.ones(p)])
        down = np.clip(state.program.parameters() - self.lowest, 0, radius)
        upper = np.concatenate([np.full(t, radius), down, np.full(2 * m + p, np.inf)])
        moves = csc_array(np.concatenate([slopes, cuts]))
        numbers = np.arange(m)
        rows = csc_array(
            (
                np.concatenate([moves.data, -moves.data, np.full(m, -1.0), np.ones(m), np.full(c, -1.0)]),
                np.concatenate([moves.indices, moves.indices, numbers, numbers, m + np.arange(c)]),
                np.concatenate(
                    [
                        moves.indptr,
                        moves.nnz + moves.indptr[1:],
                        2 * moves.nnz + 1 + np.arange(2 * m),
                        2 * moves.nnz + 2 * m + np.cumsum(np.bincount(model.parts, minlength=p)),
                    ]
                ),
            ),
            shape=(m + c, len(cost)),
        )
        solution = milp(
            cost,
            bounds=Bounds(0, upper),
            constraints=LinearConstraint(
                rows,
                np.concatenate([-residual, np.full(c, -np.inf)]),
                np.concatenate([-residual, -model.heights]),
            ),
            options={"presolve": False},
        )
        if solution.x is None:
            return np.zeros(t), 0.0
        step = solution.x[:t] - solution.x[t : 2 * t]
        before = np.abs(residual).sum() / p + (model.value if c else 0.0)
        after = np.abs(residual + slopes @ step).sum() / p + drift @ step + solution.x[2 * t + 2 * m :].sum()
        return step, float(before - after)


def _jacobian(program: AssemblyProgram) -> Float[ndarray, "p 15 t"] | None:
    """Derivatives of the leaves by the parameters; None where they are infinite: there the search ends."""
    try:
        return differentiate(program)[1]
    except ProgramError:
        return None


def _fitted(program: AssemblyProgram, boxes: Cage, penalty: _Penalty) -> AssemblyProgram:
    problem = _Problem(match_axes(boxes, execute(program)).vectors(), penalty, _lowest(program))
    return problem.minimise(program).program


def _lowest(program: AssemblyProgram) -> Float[ndarray, " t"]:
    """The least value of each parameter: lengths stay positive."""
    low: list[float] = []
    for block in program.blocks:
        low += [MIN_LENGTH] * 3
        for statement in block.statements:
            match statement:
                case Declare():
                    low += [MIN_LENGTH] * 3
                case Attach():
                    low += [-np.inf] * 6
                case Squeeze():
                    low += [-np.inf] * 2
                case Translate():
                    low += [-np.inf]
    return np.array(low)
