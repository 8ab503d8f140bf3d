"""Contact: never farther than `near`, exact where it is reached, and at rest where it holds."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.viewing.snapping import NEAR, snapped


def block(centre, size) -> Cuboid:
    return Cuboid(np.array(centre, float), np.eye(3), np.array(size, float))


def moved(cage: Cage, way: np.ndarray) -> Cage:
    return Cage(cage.part_ids, cage.centre + way, cage.axes, cage.size)


def test_a_gap_and_an_overlap_are_closed() -> None:
    floor = Cage.of({"floor": block((0, 0, 0), (1, 0.2, 1))})
    for gap in (0.6 * NEAR, -0.6 * NEAR):
        leg = Cage.of({"leg": block((0.2, 0.1 + 0.25 + gap, 0.1), (0.1, 0.5, 0.1))})
        np.testing.assert_allclose(snapped(leg, floor), [0, -gap, 0], atol=1e-15)


def test_ends_become_flush() -> None:
    seat = Cage.of({"seat": block((0, 0, 0), (1, 0.1, 1))})
    back = Cage.of({"back": block((0.01, 0.3, 0), (1, 0.5, 0.1))})
    np.testing.assert_allclose(snapped(back, seat)[0], -0.01)


def test_what_is_far_beside_attracts_nothing() -> None:
    high = Cage.of({"high": block((0, 3, 0), (1, 0.2, 1))})
    assert not snapped(Cage.of({"low": block((0.01, 0, 0), (1, 0.2, 1))}), high).any()
    assert not snapped(high, Cage.of({})).any()


numbers = st.floats(-0.6, 0.6)
lengths = st.floats(0.05, 0.8)
blocks = st.builds(lambda c, s: block(c, s), st.tuples(numbers, numbers, numbers), st.tuples(lengths, lengths, lengths))


@given(blocks, st.lists(blocks, min_size=1, max_size=4))
@settings(max_examples=100, deadline=None)
def test_no_way_is_farther_than_near_and_along_one_axis_a_second_one_is_none(own: Cuboid, others: list[Cuboid]) -> None:
    moving, rest = Cage.of({"own": own}), Cage.of({str(i): other for i, other in enumerate(others)})
    way = snapped(moving, rest)
    assert (np.abs(way) <= NEAR).all()
    for axis in np.flatnonzero(way):
        alone = np.where(np.arange(3) == axis, way, 0)
        assert abs(snapped(moved(moving, alone), rest)[axis]) < 1e-12


@given(blocks, blocks, st.tuples(numbers, numbers, numbers))
@settings(max_examples=50, deadline=None)
def test_it_doesn_t_matter_where_all_of_it_lies(own: Cuboid, other: Cuboid, offset: tuple[float, ...]) -> None:
    moving, rest, by = Cage.of({"a": own}), Cage.of({"b": other}), np.array(offset)
    near = snapped(moving, rest)
    far = snapped(moved(moving, by), moved(rest, by))
    # Ties between two ends, and distances of just NEAR, may go either way with other roundings.
    if np.abs(np.abs(near) - NEAR).min() > 1e-9 and np.abs(np.abs(far) - NEAR).min() > 1e-9:
        np.testing.assert_allclose(np.abs(near), np.abs(far), atol=1e-9)
