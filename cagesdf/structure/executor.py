"""Executing ShapeAssembly programs: from statements to the leaves' cuboids [Jones et al. 2020].

The arithmetic is written for numbers of any kind that have the operators: with floats it gives
cuboids, with `jets.Jet` their derivatives too. Vectors are triples, because arrays of three cost
more than the sums done in them. A cuboid's axes are three unit vectors, its local x, y and z.

Every block is executed in its own frame: its bbox is centred there and has the frame's axes.
"""

from collections import deque
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

from cagesdf.cuboid import Cage
from cagesdf.errors import ProgramError
from cagesdf.structure.jets import Jet, seed
from cagesdf.structure.program import (
    AXES,
    BBOX,
    AssemblyProgram,
    Attach,
    Block,
    Declare,
    Reflect,
    Squeeze,
    Translate,
    copy_name,
)

Number = Any  # float or Jet
Vector = tuple[Number, Number, Number]
Axes = tuple[Vector, Vector, Vector]

UPRIGHT: Axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ORIGIN: Vector = (0.0, 0.0, 0.0)
AXIS_ORDER = (1, 2, 0)  # height, width, length: in which ties between axes are decided

MET = 1e-4  # points closer than this have met
ALIKE = 0.01  # points, vectors closer than this count as equal where a third point is attached
ALONG = 0.9  # least cosine between an axis and the way to go along it
NEAR = 0.05  # share of the largest length: a smaller gap is not grown over
NONZERO = 1e-8  # added to denominators
TIE = 1e-9  # lattice points whose distances differ by less are equally near
LATTICE = 10  # points along each axis of a cuboid, between which the nearest pair is sought
TICKS = [i / (LATTICE - 1) for i in range(LATTICE)]
LATTICE_PLACES: list[Vector] = [(x, y, z) for z in TICKS for y in TICKS for x in TICKS]


class Body:
    """A cuboid while its block is executed."""

    __slots__ = ("aligned", "anchors", "axes", "centre", "mirror", "moves", "name", "original", "size")

    def __init__(self, name: str, size: Vector, aligned: bool) -> None:
        self.name = name
        self.size = size
        self.aligned = aligned
        self.centre: Vector = ORIGIN
        self.axes: Axes = UPRIGHT
        self.anchors: list[tuple[Vector, Vector]] = []  # place in this cuboid, and the point it was put to
        self.moves: list[tuple[Vector, str]] = []  # place in this cuboid, and the cuboid it was put to
        self.original: str = name  # what it is a copy of
        self.mirror: int | None = None  # the axis it was mirrored along as a copy

    def numbers(self) -> tuple[Number, ...]:
        """Centre (3), axes by rows (9), full lengths (3), as in `Cage.vectors`."""
        return (*self.centre, *self.axes[0], *self.axes[1], *self.axes[2], *self.size)


def execute(program: AssemblyProgram) -> Cage:
    """The cuboids of a program's leaves, in the root bbox's frame and the program's unit.

    Order: block by block in breadth, in each the declared cuboids before the copies. A part's id is
    its path, names from the root's cuboid down, joined by "/". Raises ProgramError if the numbers
    degenerate.
    """
    return _cage(program, {path: body for path, body, is_leaf in _nodes(program) if is_leaf})


def execute_nodes(program: AssemblyProgram) -> Cage:
    """The cuboids of all nodes, those that blocks fill among them: as `execute` otherwise."""
    return _cage(program, {path: body for path, body, _ in _nodes(program)})


def differentiate(program: AssemblyProgram) -> tuple[Cage, Float[ndarray, "p 15 t"]]:
    """`execute`, and the derivative of each cuboid's 15 numbers (`Cage.vectors`) by each parameter.

    Parameters are ordered as in `AssemblyProgram.parameters`. Choices (which axis is scaled,
    whether a cuboid grows, which lattice points are nearest) are taken as they fall: the
    derivative is that of the piece that the parameters lie in. Raises ProgramError as `execute`.
    """
    parameters = program.parameters()
    nodes = _nodes(program.with_parameters(seed(parameters)))
    leaves = {path: body for path, body, is_leaf in nodes if is_leaf}
    slopes = np.zeros((len(leaves), 15, len(parameters)))
    for i, body in enumerate(leaves.values()):
        for j, number in enumerate(body.numbers()):
            if isinstance(number, Jet):
                slopes[i, j] = number.slope
    if not np.isfinite(slopes).all():
        raise _degenerate(program)
    return _cage(program, leaves), slopes


def _cage(program: AssemblyProgram, bodies: dict[str, Body]) -> Cage:
    numbers = np.array([[float(number) for number in body.numbers()] for body in bodies.values()])
    if not np.isfinite(numbers).all():
        raise _degenerate(program)
    return Cage.from_vectors(tuple(bodies), numbers)


def _degenerate(program: AssemblyProgram) -> ProgramError:
    return ProgramError(
        f"program {program.blocks[0].name}", 0, "", "its numbers lead to infinite cuboids; wanted finite ones"
    )


def _nodes(program: AssemblyProgram) -> list[tuple[str, Body, bool]]:
    """Path and cuboid of each node in the root's frame, and whether it is a leaf."""
    blocks = {block.name: block for block in program.blocks}
    root = program.blocks[0]
    nodes: list[tuple[str, Body, bool]] = []
    waiting: deque[tuple[Block, Body, str, int | None]] = deque([(root, Body(BBOX, root.size, True), "", None)])
    try:
        while waiting:
            block, filled, path, mirror = waiting.popleft()
            for body in _run(block):
                _place_in(body, filled, block.size, mirror)
                inside = blocks.get(body.original)
                nodes.append((path + body.name, body, inside is None))
                if inside is not None:
                    waiting.append((inside, body, f"{path}{body.name}/", body.mirror))
    except (ZeroDivisionError, OverflowError) as error:
        raise _degenerate(program) from error
    return nodes


def _place_in(body: Body, filled: Body, size: Vector, mirror: int | None) -> None:
    """Take a cuboid from its block's frame to that of the cuboid which the block fills.

    Lengths scale with the filled cuboid; offsets do not.
    """
    if mirror is not None:
        x, y, z = body.centre
        body.centre = (-x if mirror == 0 else x, -y if mirror == 1 else y, -z if mirror == 2 else z)
        body.axes = tuple(
            (x if mirror == 0 else -x, y if mirror == 1 else -y, z if mirror == 2 else -z) for x, y, z in body.axes
        )  # type: ignore[assignment]
    body.size = tuple(own * whole / block for own, whole, block in zip(body.size, filled.size, size))  # type: ignore[assignment]
    body.centre = _add(_turned(body.centre, filled.axes), filled.centre)
    if filled.axes is not UPRIGHT:
        x, y, z = body.axes
        body.axes = (_turned(x, filled.axes), _turned(y, filled.axes), _turned(z, filled.axes))


def _run(block: Block) -> list[Body]:
    """Execute one block; its cuboids in its own frame, declared ones before copies."""
    bodies = {BBOX: Body(BBOX, block.size, True)}
    for statement in block.statements:
        match statement:
            case Attach(a, b, at_a, at_b):
                _attach(bodies[a], bodies[b], at_a, at_b)
            case Declare(name, size, aligned):
                bodies[name] = Body(name, size, aligned)
            case Squeeze():
                for attach in statement.attaches():
                    _attach(bodies[attach.a], bodies[attach.b], attach.at_a, attach.at_b)
            case Reflect(name, letter):
                _reflect(bodies, bodies[name], AXES.index(letter))
            case Translate(name, letter, count, span):
                axis = AXES.index(letter)
                for i in range(1, count + 1):
                    _translate(bodies, bodies[name], axis, block.size[axis] * span * (i / count))
    del bodies[BBOX]
    return sorted(bodies.values(), key=lambda body: body.original != body.name)


def _copy(bodies: dict[str, Body], body: Body) -> Body:
    name = copy_name(len(bodies) - 1)
    copy = bodies[name] = Body(name, body.size, body.aligned)
    copy.original = body.name
    return copy


def _reflect(bodies: dict[str, Body], body: Body, axis: int) -> None:
    copy = _copy(bodies, body)
    copy.mirror = axis
    for q, target in body.moves:
        point = _with(_point(body, q), axis, -_point(body, q)[axis])
        _attach(copy, bodies[target], _with(q, axis, 1.0 - q[axis]), _clamped(_place(bodies[target], point)))


def _translate(bodies: dict[str, Body], body: Body, axis: int, way: Number) -> None:
    copy = _copy(bodies, body)
    for q, target in body.moves:
        point = _point(body, q)
        point = _with(point, axis, point[axis] + way)
        _attach(copy, bodies[target], q, _clamped(_place(bodies[target], point)))


def _attach(a: Body, b: Body, at_a: Vector, at_b: Vector) -> None:
    """Put the place `at_a` of `a` to the point of `b` at `at_b`, as far as earlier attachments allow.

    The first moves `a`. A second one turns and stretches it about the first's point; later ones
    turn it about the first two's line and stretch it. A cuboid that is aligned doesn't turn: it
    grows towards `b` instead.
    """
    goal = _point(b, at_b)
    b.anchors.append((at_b, goal))
    if not a.anchors:
        a.centre = _add(a.centre, _sub(goal, _point(a, at_a)))
    elif a.aligned:
        _grow(a, b)
    elif len(a.anchors) == 1:
        _second(a, at_a, goal)
    else:
        _general(a, at_a, goal)
    a.anchors.append((at_a, goal))
    a.moves.append((at_a, b.name))


def _second(a: Body, at: Vector, goal: Vector) -> None:
    """Turn and stretch a cuboid that is held at one point, so that another place meets `goal`."""
    held, pin = a.anchors[0]
    begin = _point(a, at)
    if _length(_sub(begin, goal)) < MET:
        return
    distance = _length(_sub(goal, pin))
    offset = _sub(begin, pin)
    arms = [_sub(_arm(a, at, k), _arm(a, held, k)) for k in range(3)]
    growths: list[tuple[float, int, int, Number]] = []
    for k in AXIS_ORDER:
        if _size(_arm(a, at, k)) + _size(_arm(a, held, k)) < MET:
            continue
        growth = _growth(arms[k], offset, distance)
        if growth is not None:
            growths.append((abs(float(growth)), len(growths), k, growth))
    if growths:
        _, _, k, growth = min(growths, key=lambda item: item[:2])
        a.size = _with(a.size, k, a.size[k] + growth)
    else:
        growth = _growth(_add(_add(arms[0], arms[1]), arms[2]), offset, distance)
        if growth is not None:
            a.size = (a.size[0] + growth, a.size[1] + growth, a.size[2] + growth)
    _pin(a, held, pin)
    old, new = _sub(_point(a, at), pin), _sub(goal, pin)
    if _is_zero(old) or _is_zero(new) or _length(_sub(old, new)) < MET:
        return
    _turn(a, old, new)
    _pin(a, held, pin)


def _growth(arm: Vector, offset: Vector, distance: Number) -> Number | None:
    """By how much a length must change so that `offset` + growth · `arm` has the length `distance`."""
    a, b, c = _dot(arm, arm), 2 * _dot(arm, offset), _dot(offset, offset) - distance * distance
    discriminant = b * b - 4 * a * c
    return (discriminant**0.5 - b) / (2 * a + NONZERO) if discriminant > 0 else None


def _general(a: Body, at: Vector, goal: Vector) -> None:
    """Turn a cuboid about the line of its first two anchors, then stretch it towards `goal`."""
    first = a.anchors[0][1]
    line = _sub(a.anchors[1][1], first)
    if len(a.anchors) == 2 or all(_length(_cross(_sub(g, first), line)) <= ALIKE for _, g in a.anchors):
        _orient(a, at, goal)
    _stretch(a, at, goal)


def _orient(a: Body, at: Vector, goal: Vector) -> None:
    held, first = a.anchors[0]
    way = _sub(first, a.anchors[1][1])
    axis = _scaled(way, 1 / (_length(way) + NONZERO))
    begin = _point(a, at)

    def onto_plane(point: Vector) -> Vector:
        return _add(point, _scaled(axis, _dot(_sub(begin, point), axis) / (_dot(axis, axis) + NONZERO)))

    foot = onto_plane(first)
    old, new = _sub(begin, foot), _sub(onto_plane(goal), foot)
    a2, c = _dot(old, old), _dot(old, old) - _dot(new, new)
    b2 = 2 * a2
    discriminant = b2 * b2 - 4 * a2 * c
    if discriminant >= 0:
        old = _scaled(old, 1 + (discriminant**0.5 - b2) / (2 * a2 + NONZERO))
    if _is_zero(old) or _is_zero(new) or _length(_sub(old, new)) < ALIKE:
        return
    cosine = _dot(_scaled(old, 1 / (_length(old) + NONZERO)), _scaled(new, 1 / (_length(new) + NONZERO)))
    sine = (1 - cosine * cosine) ** 0.5 if abs(cosine) < 1 else 0.0
    if _length(_sub(_rotated(old, axis, cosine, sine), new)) > ALIKE:
        sine = -sine
    x, y, z = a.axes
    a.axes = (
        _rotated(x, axis, cosine, sine),
        _rotated(y, axis, cosine, sine),
        _rotated(z, axis, cosine, sine),
    )
    _pin(a, held, first)


def _stretch(a: Body, at: Vector, goal: Vector) -> None:
    held, pin = a.anchors[0]
    way = _sub(goal, _point(a, at))
    length = _length(way)
    if length < ALIKE:
        return
    chosen = None
    for k in AXIS_ORDER:
        arm, pinned = _arm(a, at, k), _arm(a, held, k)
        if any(_length(_sub(_arm(a, q, k), pinned)) > ALIKE for q, _ in a.anchors) or _is_zero(arm):
            continue
        direction = _scaled(arm, 1 / _length(arm))
        if _dot(way, direction) / length > ALONG:
            chosen = k, direction, _length(_sub(arm, pinned))  # the last one wins
    if chosen:
        k, direction, share = chosen
        a.size = _with(a.size, k, a.size[k] + abs(_dot(way, direction)) / (share + NONZERO))
    _pin(a, held, pin)


def _grow(a: Body, b: Body) -> None:
    """Grow an aligned cuboid towards `b`, unless a corner of one is in the other or they are near."""
    if _has_corner_in(a, b) or _has_corner_in(b, a):
        return
    q, nearest = _nearest_lattice_places(a, b)
    gap = _sub(_point(b, nearest), _point(a, q))
    if _length(gap) < NEAR * max(map(float, (*a.size, *b.size))):
        return
    kept = (1 - q[0], 1 - q[1], 1 - q[2])
    point = _point(a, kept)
    for k in range(3):
        share = q[k] - 0.5
        if share != 0:
            growth = gap[k] / (2 * share)
            if growth > 0:
                a.size = _with(a.size, k, a.size[k] + growth)
    _pin(a, kept, point)


def _has_corner_in(a: Body, b: Body) -> bool:
    """Whether a corner of `a` is in `b`, faces included."""
    if a.axes is UPRIGHT and b.axes is UPRIGHT:
        for k in range(3):
            reach, at = 0.5 * a.size[k], a.centre[k] - b.centre[k]
            if not (0 <= (at - reach) / b.size[k] + 0.5 <= 1 or 0 <= (at + reach) / b.size[k] + 0.5 <= 1):
                return False
        return True
    corners = ((x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0))
    return any(all(0 <= number <= 1 for number in _place(b, _point(a, corner))) for corner in corners)


def _nearest_lattice_places(a: Body, b: Body) -> tuple[Vector, Vector]:
    """Of each cuboid's lattice of LATTICE³ points the places of the two that are nearest to each other."""
    if a.axes is UPRIGHT and b.axes is UPRIGHT:
        (ax, bx), (ay, by), (az, bz) = (_nearest_ticks(a, b, k) for k in range(3))
        return (ax, ay, az), (bx, by, bz)
    points_a, points_b = _lattice_points(a), _lattice_points(b)
    distance, _ = cKDTree(points_b).query(points_a)
    first = int(np.argmax(distance <= distance.min() + TIE))
    apart = np.linalg.norm(points_b - points_a[first], axis=1)
    second = int(np.argmax(apart <= apart.min() + TIE))
    return LATTICE_PLACES[first], LATTICE_PLACES[second]


def _nearest_ticks(a: Body, b: Body, k: int) -> tuple[float, float]:
    ticks_a, ticks_b = (
        [float(body.centre[k]) + (tick - 0.5) * float(body.size[k]) for tick in TICKS] for body in (a, b)
    )
    gaps = [[abs(x - y) for y in ticks_b] for x in ticks_a]
    least = min(map(min, gaps)) + TIE
    i = next(i for i, row in enumerate(gaps) if min(row) <= least)
    j = next(j for j, gap in enumerate(gaps[i]) if gap <= least)
    return TICKS[i], TICKS[j]


def _lattice_points(body: Body) -> Float[ndarray, "n 3"]:
    size, centre = (np.array([float(number) for number in triple]) for triple in (body.size, body.centre))
    axes = np.array([[float(number) for number in axis] for axis in body.axes])
    return ((np.array(LATTICE_PLACES) - 0.5) * size) @ axes + centre


# Cuboids and places in them: 0 and 1 are the faces along each axis.


def _point(body: Body, q: Vector) -> Vector:
    x, y, z = (q[0] - 0.5) * body.size[0], (q[1] - 0.5) * body.size[1], (q[2] - 0.5) * body.size[2]
    cx, cy, cz = body.centre
    if body.axes is UPRIGHT:
        return (x + cx, y + cy, z + cz)
    (ax, ay, az), (bx, by, bz), (gx, gy, gz) = body.axes
    return (ax * x + bx * y + gx * z + cx, ay * x + by * y + gy * z + cy, az * x + bz * y + gz * z + cz)


def _place(body: Body, point: Vector) -> Vector:
    offset, (x, y, z), size = _sub(point, body.centre), body.axes, body.size
    if body.axes is UPRIGHT:
        return (offset[0] / size[0] + 0.5, offset[1] / size[1] + 0.5, offset[2] / size[2] + 0.5)
    return (_dot(offset, x) / size[0] + 0.5, _dot(offset, y) / size[1] + 0.5, _dot(offset, z) / size[2] + 0.5)


def _arm(body: Body, q: Vector, k: int) -> Vector:
    """By how much the point at `q` moves when length number `k` grows by one."""
    return _scaled(body.axes[k], q[k] - 0.5)


def _pin(body: Body, q: Vector, point: Vector) -> None:
    """Move a cuboid so that its place `q` is at `point`."""
    body.centre = _add(body.centre, _sub(point, _point(body, q)))


def _clamped(q: Vector) -> Vector:
    x, y, z = (0.0 if number < 0 else 1.0 if number > 1 else number for number in q)
    return (x, y, z)


def _turn(body: Body, old: Vector, new: Vector) -> None:
    """The least rotation that takes the direction of `old` to that of `new`.

    Opposite and equal directions, where their cross product is exactly zero, get half a turn about
    an axis of their own choosing, as in the official executor.
    """
    u, v = _scaled(old, 1 / _length(old)), _scaled(new, 1 / _length(new))
    axis = _cross(u, v)
    if _is_zero(axis):
        if u[0] != 0:
            axis = (u[0], -u[2], u[1])
        elif u[1] != 0:
            axis = (u[2], u[1], -u[0])
        else:
            axis = (-u[1], u[0], u[2])
        cosine, sine = -1.0, 0.0
        unit = _scaled(axis, 1 / _length(axis))
    else:
        cosine, sine = _dot(u, v), _length(axis)
        if abs(cosine) >= 1:
            return
        unit = _scaled(axis, 1 / sine)
    x, y, z = body.axes
    body.axes = (
        _rotated(x, unit, cosine, sine),
        _rotated(y, unit, cosine, sine),
        _rotated(z, unit, cosine, sine),
    )


def _rotated(v: Vector, axis: Vector, cosine: Number, sine: Number) -> Vector:
    """Rodrigues' formula; `axis` is a unit vector."""
    along = _dot(axis, v) * (1 - cosine)
    c = _cross(axis, v)
    return (
        v[0] * cosine + c[0] * sine + axis[0] * along,
        v[1] * cosine + c[1] * sine + axis[1] * along,
        v[2] * cosine + c[2] * sine + axis[2] * along,
    )


# Vectors.


def _add(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _sub(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _scaled(a: Vector, factor: Number) -> Vector:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def _dot(a: Vector, b: Vector) -> Number:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _length(a: Vector) -> Number:
    return _dot(a, a) ** 0.5


def _size(a: Vector) -> float:
    """Sum of absolute values."""
    return abs(float(a[0])) + abs(float(a[1])) + abs(float(a[2]))


def _is_zero(a: Vector) -> bool:
    return float(a[0]) == 0 and float(a[1]) == 0 and float(a[2]) == 0


def _with(a: Vector, k: int, number: Number) -> Vector:
    if k == 0:
        return (number, a[1], a[2])
    return (a[0], number, a[2]) if k == 1 else (a[0], a[1], number)


def _turned(v: Vector, axes: Axes) -> Vector:
    """From a cuboid's axes to those of its frame."""
    if axes is UPRIGHT:
        return v
    x, y, z = axes
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )
