"""Numbers that carry their derivatives: forward-mode differentiation of the executor."""

from typing import Union

import numpy as np
from jaxtyping import Float
from numpy import ndarray

Real = Union[float, int, "DualNumber"]


class DualNumber:
    """A value and its derivative by each parameter. Comparisons look at the value alone.

    Multiplied by an exact 0 it becomes the number 0, by an exact 1 it stays itself: most axes of a
    program's cuboids are upright, and their zeros and ones then cost nothing.
    """

    __slots__ = ("slope", "value")

    def __init__(self, value: float, slope: Float[ndarray, " t"]) -> None:
        self.value = value
        self.slope = slope

    def __float__(self) -> float:
        return self.value

    def __repr__(self) -> str:
        return f"DualNumber({self.value!r})"

    def __neg__(self) -> "DualNumber":
        return DualNumber(-self.value, -self.slope)

    def __abs__(self) -> "DualNumber":
        return -self if self.value < 0 else self

    def __add__(self, other: Real) -> "DualNumber":
        if isinstance(other, DualNumber):
            return DualNumber(self.value + other.value, self.slope + other.slope)
        return DualNumber(self.value + other, self.slope)

    __radd__ = __add__

    def __sub__(self, other: Real) -> "DualNumber":
        if isinstance(other, DualNumber):
            return DualNumber(self.value - other.value, self.slope - other.slope)
        return DualNumber(self.value - other, self.slope)

    def __rsub__(self, other: float | int) -> "DualNumber":
        return DualNumber(other - self.value, -self.slope)

    def __mul__(self, other: Real) -> Real:
        if isinstance(other, DualNumber):
            return DualNumber(self.value * other.value, self.slope * other.value + other.slope * self.value)
        if other == 0:
            return 0.0
        return self if other == 1 else DualNumber(self.value * other, self.slope * other)

    __rmul__ = __mul__

    def __truediv__(self, other: Real) -> Real:
        if isinstance(other, DualNumber):
            quotient = self.value / other.value
            return DualNumber(quotient, (self.slope - other.slope * quotient) * (1 / other.value))
        return self * (1 / other)

    def __rtruediv__(self, other: float | int) -> Real:
        if other == 0:
            return 0.0
        quotient = other / self.value
        return DualNumber(quotient, self.slope * (-quotient / self.value))

    def __pow__(self, exponent: float | int) -> "DualNumber":
        power = self.value**exponent
        # The length of a zero vector has no derivative; nothing uses it where it is computed.
        return DualNumber(power, self.slope * (exponent * power / self.value) if self.value else self.slope * 0.0)

    def __eq__(self, other: object) -> bool:
        return self.value == (other.value if isinstance(other, DualNumber) else other)

    def __lt__(self, other: Real) -> bool:
        return self.value < float(other)

    def __le__(self, other: Real) -> bool:
        return self.value <= float(other)

    def __gt__(self, other: Real) -> bool:
        return self.value > float(other)

    def __ge__(self, other: Real) -> bool:
        return self.value >= float(other)

    __hash__ = None  # type: ignore[assignment]


def seed(values: Float[ndarray, " t"]) -> list[DualNumber]:
    """The parameters as dual numbers: each one's derivative by itself is 1, by the others 0."""
    return [DualNumber(value, slope) for value, slope in zip(values.tolist(), np.eye(len(values)))]
