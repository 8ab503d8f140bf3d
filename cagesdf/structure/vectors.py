"""Triples of numbers of any kind that have the operators: floats, or dual numbers."""

from typing import Any

Number = Any  # float or DualNumber
Vector = tuple[Number, Number, Number]
Axes = tuple[Vector, Vector, Vector]

UPRIGHT: Axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ORIGIN: Vector = (0.0, 0.0, 0.0)


def rotated(v: Vector, axis: Vector, cosine: Number, sine: Number) -> Vector:
    """Rodrigues' formula; `axis` is a unit vector."""
    along = dot(axis, v) * (1 - cosine)
    c = cross(axis, v)
    return (
        v[0] * cosine + c[0] * sine + axis[0] * along,
        v[1] * cosine + c[1] * sine + axis[1] * along,
        v[2] * cosine + c[2] * sine + axis[2] * along,
    )


def add(a: Vector, b: Vector) -> Vector:
    """Sum."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a: Vector, b: Vector) -> Vector:
    """Difference."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scaled(a: Vector, factor: Number) -> Vector:
    """Product with a number."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def dot(a: Vector, b: Vector) -> Number:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def length(a: Vector) -> Number:
    """Euclidean length."""
    return dot(a, a) ** 0.5


def is_zero(a: Vector) -> bool:
    """Whether all numbers are exactly 0."""
    return float(a[0]) == 0 and float(a[1]) == 0 and float(a[2]) == 0


def with_number(a: Vector, k: int, number: Number) -> Vector:
    """The vector with another number in place k."""
    if k == 0:
        return (number, a[1], a[2])
    return (a[0], number, a[2]) if k == 1 else (a[0], a[1], number)


def turned(v: Vector, axes: Axes) -> Vector:
    """A vector in a cuboid's axes, expressed in those of its frame."""
    if axes is UPRIGHT:
        return v
    x, y, z = axes
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )
