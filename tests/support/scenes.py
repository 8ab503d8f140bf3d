"""Grids of scenes for the report."""

import numpy as np

from cagesdf.cuboid import Cage, Cuboid
from cagesdf.rendering import Scene
from cagesdf.report.grid import Grid
from tests.support import toy


def grid() -> Grid:
    cage = Cage.of({"a": Cuboid(np.zeros(3), np.eye(3), np.ones(3))})
    ball = Scene((toy.ball((0.0, 0.0, 0.0), 0.5),), ("#d8c3ab",), cage, ("#4c78a8",))
    return Grid(
        ("one", "two"),
        (False, True),
        ("first", "second"),
        ((ball, None), (Scene(cage=cage, cage_colours=("#112233",)), ball)),
    )


TWO = [("balls", grid()), ("none", Grid((), (), (), ()))]
