"""Executing ShapeAssembly programs: from statements to the leaves' cuboids [Jones et al. 2020].

The arithmetic is written for numbers of any kind that have the operators: with floats it gives
cuboids, with `dual_numbers.DualNumber` their derivatives too. Vectors are triples, because arrays of three cost
more than the sums done in them. A cuboid's axes are three unit vectors, its local x, y and z.

Every block is executed in its own frame: its bbox is centred there and has the frame's axes.
"""

import math
from collections import deque

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

from cagesdf.cuboid import Cage
from cagesdf.errors import ProgramError
from cagesdf.structure.dual_numbers import DualNumber, seed
from cagesdf.structure.program import (
    AXES,
    BBOX,
    AssemblyProgram,
    Attach,
    Block,
    Declare,
    Reflect,
    Squeeze,
    Statement,
    Translate,
    copy_name,
)
from cagesdf.structure.vectors import (
    ORIGIN,
    UPRIGHT,
    Axes,
    Number,
    Vector,
    add,
    cross,
    dot,
    is_zero,
    length,
    rotated,
    scaled,
    sub,
    turned,
    with_number,
)

AXIS_ORDER = (1, 2, 0)  # height, width, length: in which ties between axes are decided

MET = 1e-4  # points closer than this have met; a shorter vector has no direction
ALIKE = 0.01  # points, vectors closer than this count as equal where a third point is attached
ALONG = 0.9  # least cosine between an axis and the way to go along it
NEAR = 0.05  # share of the largest length: a smaller gap is not grown over
VANISHING = 1e-6  # share of a cuboid's reach: a goal nearer to its first anchor is that anchor
TIE = 1e-9  # distances that differ by less are equal: then the first counts
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
        self.original: str = name  # the declared cuboid that it is, or is a copy of
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
    derivative belongs to the smooth piece that the parameters lie in. Raises ProgramError as `execute`.
    """
    parameters = program.parameters()
    with np.errstate(over="ignore", invalid="ignore"):  # what isn't finite is refused below
        nodes = _nodes(program.with_parameters(seed(parameters)))
    leaves = {path: body for path, body, is_leaf in nodes if is_leaf}
    slopes = np.zeros((len(leaves), 15, len(parameters)))
    for i, body in enumerate(leaves.values()):
        for j, number in enumerate(body.numbers()):
            if isinstance(number, DualNumber):
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
        bodies = {block.name: _run(block) for block in program.blocks}
        while waiting:
            block, filled, path, mirror = waiting.popleft()
            for member in bodies[block.name]:
                body = _placed_in(member, filled, block.size, mirror)
                inside = blocks.get(body.original)
                nodes.append((path + body.name, body, inside is None))
                if inside is not None:
                    waiting.append((inside, body, f"{path}{body.name}/", body.mirror))
    except (ZeroDivisionError, OverflowError) as error:
        raise _degenerate(program) from error
    return nodes


def _placed_in(body: Body, filled: Body, size: Vector, mirror: int | None) -> Body:
    """A cuboid of a block in the frame of the cuboid which the block fills.

    Lengths scale with the filled cuboid; offsets do not. `mirror` reaches no further than this
    block: blocks within a mirrored one are turned with their cuboid, as in the official executor.
    """
    centre, axes = body.centre, body.axes
    if mirror is not None:
        # Without the sign the mirrored axes would be left-handed.
        centre = with_number(centre, mirror, -centre[mirror])
        axes = tuple(with_number((-x, -y, -z), mirror, (x, y, z)[mirror]) for x, y, z in axes)  # type: ignore[assignment]
    if filled.axes is not UPRIGHT:
        x, y, z = axes
        axes = (turned(x, filled.axes), turned(y, filled.axes), turned(z, filled.axes))
    length, height, width = (side * whole / block for side, whole, block in zip(body.size, filled.size, size))
    placed = Body(body.name, (length, height, width), body.aligned)
    placed.centre = add(turned(centre, filled.axes), filled.centre)
    placed.axes = axes
    placed.original, placed.mirror = body.original, body.mirror
    return placed


def _run(block: Block) -> list[Body]:
    """Execute one block; its cuboids in its own frame, declared ones before copies."""
    bodies = {BBOX: Body(BBOX, block.size, True)}
    for statement in block.statements:
        run_statement(bodies, statement)
    del bodies[BBOX]
    return sorted(bodies.values(), key=lambda body: body.original != body.name)


def run_statement(bodies: dict[str, Body], statement: Statement) -> None:
    """Execute one statement of a block, after those that made `bodies`, by name, its bbox among them.

    Raises ZeroDivisionError or OverflowError if the numbers degenerate.
    """
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
                _translate(bodies, bodies[name], axis, bodies[BBOX].size[axis] * span * (i / count))


def _copy(bodies: dict[str, Body], body: Body) -> Body:
    name = copy_name(len(bodies) - 1)
    copy = bodies[name] = Body(name, body.size, body.aligned)
    copy.original = body.name
    return copy


def _reflect(bodies: dict[str, Body], body: Body, axis: int) -> None:
    copy = _copy(bodies, body)
    copy.mirror = axis
    for q, target in body.moves:
        point = with_number(_point(body, q), axis, -_point(body, q)[axis])
        _attach(copy, bodies[target], with_number(q, axis, 1.0 - q[axis]), _clamped(_place(bodies[target], point)))


def _translate(bodies: dict[str, Body], body: Body, axis: int, offset: Number) -> None:
    copy = _copy(bodies, body)
    for q, target in body.moves:
        point = _point(body, q)
        point = with_number(point, axis, point[axis] + offset)
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
        a.centre = add(a.centre, sub(goal, _point(a, at_a)))
    elif a.aligned:
        _grow(a, b)
    elif len(a.anchors) == 1:
        _second(a, at_a, goal)
    else:
        _general(a, at_a, goal)
    a.anchors.append((at_a, goal))
    a.moves.append((at_a, b.name))


def _second(a: Body, at: Vector, goal: Vector) -> None:
    """Turn and stretch a cuboid that is held at one point, so that another place meets `goal`.

    Nothing but a length of 0 brings two places together at one point: then it stays as it is.
    """
    held, pin = a.anchors[0]
    begin = _point(a, at)
    if length(sub(begin, goal)) < MET:
        return
    distance = length(sub(goal, pin))
    offset = sub(begin, pin)
    if distance <= VANISHING * length(offset):
        return
    arms = [sub(_arm(a, at, k), _arm(a, held, k)) for k in range(3)]
    growths: list[tuple[int, Number]] = []
    for k in AXIS_ORDER:
        growth = _growth(arms[k], offset, distance)
        if growth is not None:
            growths.append((k, growth))
    if growths:
        least = min(abs(float(growth)) for _, growth in growths) + TIE
        k, growth = next(item for item in growths if abs(item[1]) <= least)
        a.size = with_number(a.size, k, a.size[k] + growth)
    else:
        growth = _growth(add(add(arms[0], arms[1]), arms[2]), offset, distance)
        if growth is not None:
            a.size = (a.size[0] + growth, a.size[1] + growth, a.size[2] + growth)
    _pin(a, held, pin)
    old, new = sub(_point(a, at), pin), sub(goal, pin)
    if is_zero(old) or length(sub(old, new)) < MET:
        return
    _turn(a, old, new)
    _pin(a, held, pin)


def _growth(arm: Vector, offset: Vector, distance: Number) -> Number | None:
    """Change of a length that gives `offset` + growth · `arm` the length `distance`; None if none does."""
    a, b, c = dot(arm, arm), 2 * dot(arm, offset), dot(offset, offset) - distance * distance
    if a < MET * MET:
        return None
    discriminant = b * b - 4 * a * c
    return (discriminant**0.5 - b) / (2 * a) if discriminant > 0 else None


def _general(a: Body, at: Vector, goal: Vector) -> None:
    """Turn a cuboid about the line of its first two anchors, then stretch it towards `goal`."""
    first = a.anchors[0][1]
    line = sub(a.anchors[1][1], first)
    if len(a.anchors) == 2 or all(length(cross(sub(g, first), line)) <= ALIKE for _, g in a.anchors):
        _orient(a, at, goal)
    _stretch(a, at, goal)


def _orient(a: Body, at: Vector, goal: Vector) -> None:
    """Turn a cuboid about the line of its first two anchors, so that a place comes as near to `goal` as that goes."""
    held, first = a.anchors[0]
    line = sub(first, a.anchors[1][1])
    if length(line) < MET:
        return
    axis = scaled(line, 1 / length(line))
    old, new = (_across(sub(point, first), axis) for point in (_point(a, at), goal))
    radius, reach = length(old), length(new)
    if radius < MET or reach < MET or length(sub(scaled(old, reach / radius), new)) < ALIKE:
        return
    scale = 1 / (radius * reach)
    cosine, sine = dot(old, new) * scale, dot(axis, cross(old, new)) * scale
    x, y, z = a.axes
    a.axes = (
        rotated(x, axis, cosine, sine),
        rotated(y, axis, cosine, sine),
        rotated(z, axis, cosine, sine),
    )
    _pin(a, held, first)


def _across(v: Vector, axis: Vector) -> Vector:
    """Component of a vector perpendicular to a unit vector."""
    return sub(v, scaled(axis, dot(v, axis)))


def _stretch(a: Body, at: Vector, goal: Vector) -> None:
    held, pin = a.anchors[0]
    gap = sub(goal, _point(a, at))
    distance = length(gap)
    if distance < ALIKE:
        return
    chosen = None
    for k in AXIS_ORDER:
        arm, pinned = _arm(a, at, k), _arm(a, held, k)
        if any(length(sub(_arm(a, q, k), pinned)) > ALIKE for q, _ in a.anchors) or is_zero(arm):
            continue
        direction, share = scaled(arm, 1 / length(arm)), length(sub(arm, pinned))
        if share >= MET and dot(gap, direction) / distance > ALONG:
            chosen = k, direction, share  # the last one wins
    if chosen:
        k, direction, share = chosen
        a.size = with_number(a.size, k, a.size[k] + abs(dot(gap, direction)) / share)
    _pin(a, held, pin)


def _grow(a: Body, b: Body) -> None:
    """Grow an aligned cuboid towards `b`, unless a corner of one is in the other or they are near."""
    if _has_corner_in(a, b) or _has_corner_in(b, a):
        return
    q, nearest = _nearest_lattice_places(a, b)
    gap = sub(_point(b, nearest), _point(a, q))
    if length(gap) < NEAR * max(map(float, (*a.size, *b.size))):
        return
    kept = (1 - q[0], 1 - q[1], 1 - q[2])
    point = _point(a, kept)
    for k in range(3):
        share = q[k] - 0.5
        if share != 0:
            growth = gap[k] / (2 * share)
            if growth > 0:
                a.size = with_number(a.size, k, a.size[k] + growth)
    _pin(a, kept, point)


def _has_corner_in(a: Body, b: Body) -> bool:
    """Whether a corner of `a` is in `b`, faces included."""
    if a.axes is UPRIGHT and b.axes is UPRIGHT:
        for k in range(3):
            reach, at, half = 0.5 * a.size[k], a.centre[k] - b.centre[k], abs(0.5 * b.size[k])
            if abs(at - reach) > half and abs(at + reach) > half:
                return False
        return True
    corners = ((x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0))
    offsets = (sub(_point(a, corner), b.centre) for corner in corners)
    return any(all(abs(dot(offset, b.axes[k])) <= abs(0.5 * b.size[k]) for k in range(3)) for offset in offsets)


def _nearest_lattice_places(a: Body, b: Body) -> tuple[Vector, Vector]:
    """Places of the nearest two points of the cuboids' lattices, LATTICE³ points each.

    Among equally near pairs the one with the first point in a's lattice, x fastest, then in b's, is taken.
    """
    if not all(math.isfinite(number) for number in (*a.centre, *a.size, *b.centre, *b.size)):
        raise OverflowError
    if a.axes is UPRIGHT and b.axes is UPRIGHT:
        (ax, bx), (ay, by), (az, bz) = (_nearest_ticks(a, b, k) for k in range(3))
        return (ax, ay, az), (bx, by, bz)
    with np.errstate(over="ignore"):
        points_a, points_b = _lattice_points(a), _lattice_points(b)
        distance = np.asarray(cKDTree(points_b).query(points_a)[0])
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
    offset, (x, y, z), size = sub(point, body.centre), body.axes, body.size
    if body.axes is UPRIGHT:
        return (offset[0] / size[0] + 0.5, offset[1] / size[1] + 0.5, offset[2] / size[2] + 0.5)
    return (dot(offset, x) / size[0] + 0.5, dot(offset, y) / size[1] + 0.5, dot(offset, z) / size[2] + 0.5)


def _arm(body: Body, q: Vector, k: int) -> Vector:
    """Movement of the point at `q` when length number `k` grows by one."""
    return scaled(body.axes[k], q[k] - 0.5)


def _pin(body: Body, q: Vector, point: Vector) -> None:
    """Move a cuboid so that its place `q` is at `point`."""
    body.centre = add(body.centre, sub(point, _point(body, q)))


def _clamped(q: Vector) -> Vector:
    x, y, z = (0.0 if number < 0 else 1.0 if number > 1 else number for number in q)
    return (x, y, z)


def _turn(body: Body, old: Vector, new: Vector) -> None:
    """The least rotation that takes the direction of `old` to that of `new`.

    Opposite and equal directions, where their cross product is exactly zero, get half a turn about
    an axis of their own choosing, as in the official executor.
    """
    u, v = scaled(old, 1 / length(old)), scaled(new, 1 / length(new))
    axis = cross(u, v)
    if is_zero(axis):
        if u[0] != 0:
            axis = (u[0], -u[2], u[1])
        elif u[1] != 0:
            axis = (u[2], u[1], -u[0])
        else:
            axis = (-u[1], u[0], u[2])
        cosine, sine = -1.0, 0.0
        unit = scaled(axis, 1 / length(axis))
    else:
        cosine, sine = dot(u, v), length(axis)
        if cosine >= 1:
            return
        unit = scaled(axis, 1 / sine)
    x, y, z = body.axes
    body.axes = (
        rotated(x, unit, cosine, sine),
        rotated(y, unit, cosine, sine),
        rotated(z, unit, cosine, sine),
    )
