"""The surface in the scene of a tab: parts that are the same are not sent again, the others replaced."""

from types import SimpleNamespace
from unittest.mock import MagicMock, Mock

import numpy as np
import pytest
from viser import ClientHandle

from cagesdf.cuboid import Cage
from cagesdf.extraction import Extraction
from cagesdf.geometry.meshes import Mesh, is_closed, weld
from cagesdf.geometry.solid import as_manifold, cage_surface, from_manifold
from cagesdf.viewing.scene import Stage
from tests.support.attached import box

COLOURS = {"a": (1, 2, 3), "b": (4, 5, 6), "c": (7, 8, 9)}


class Nodes:
    """Takes meshes as viser's scene does, and remembers those that are there."""

    def __init__(self) -> None:
        self.there: dict[str, SimpleNamespace] = {}
        self.sent = 0

    def add(self, name: str, vertices: np.ndarray, faces: np.ndarray, **look: object) -> SimpleNamespace:
        assert name not in self.there, "a node of that name is there"
        self.sent += 1
        self.there[name] = node = SimpleNamespace(
            vertices=vertices, faces=faces, remove=lambda: self.there.pop(name), **look
        )
        return node


@pytest.fixture
def nodes() -> Nodes:
    return Nodes()


@pytest.fixture
def stage(nodes: Nodes) -> Stage:
    client = MagicMock(spec=ClientHandle)
    client.camera, client.scene = MagicMock(position=np.zeros(3)), MagicMock(add_mesh_simple=nodes.add)
    return Stage(client, Mock(), Mock(), Mock())


def solid(height: float) -> Mesh:
    return cage_surface(Cage.of({"": box((0, 0, 0), (0.5, height, 0.5))}))


def test_only_parts_that_differ_are_sent_and_what_they_replace_goes(stage: Stage, nodes: Nodes) -> None:
    stage.show_parts({"a": solid(0.1), "b": solid(0.2)}, COLOURS, set(), "Parts")
    assert nodes.sent == 2
    stage.show_parts({"a": solid(0.1), "b": solid(0.3)}, COLOURS, set(), "Parts")
    assert nodes.sent == 3
    heights = sorted(np.ptp(node.vertices[:, 1]) for node in nodes.there.values())
    np.testing.assert_allclose(heights, [0.1, 0.3], rtol=1e-6)
    stage.show_parts({"c": solid(0.1)}, COLOURS, set(), "Parts")
    assert len(nodes.there) == 1


def test_a_part_that_lost_its_surface_is_gone(stage: Stage, nodes: Nodes) -> None:
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    stage.show_parts({"a": solid(0.1), "b": solid(0.2)}, COLOURS, set(), "Parts")
    stage.show_parts({"a": nothing, "b": solid(0.2)}, COLOURS, set(), "Parts")
    assert len(nodes.there) == 1
    stage.show_parts({"a": solid(0.1), "b": solid(0.2)}, COLOURS, set(), "Parts")
    assert (len(nodes.there), nodes.sent) == (2, 3)


def test_parts_that_stay_take_the_look_and_what_is_hidden_anew(stage: Stage, nodes: Nodes) -> None:
    parts = {"a": solid(0.1), "b": solid(0.2)}
    stage.show_parts(parts, COLOURS, set(), "Parts")
    assert {node.color for node in nodes.there.values()} == {COLOURS["a"], COLOURS["b"]}
    stage.show_parts(parts, COLOURS, {"b"}, "Wireframe")
    assert nodes.sent == 2
    assert [node.wireframe for node in nodes.there.values()] == [True, True]
    assert sorted(node.visible for node in nodes.there.values()) == [False, True]


def test_while_a_part_is_hidden_the_others_are_closed(stage: Stage, nodes: Nodes) -> None:
    cage = Cage.of({"a": box((0, 0, 0), (0.5, 0.1, 0.5)), "b": box((0, 0.2, 0), (0.1, 0.5, 0.1))})
    parts = {part: cage_surface(Cage.of({part: cage[part]})) for part in cage.part_ids}
    union = from_manifold(as_manifold(parts["a"]) + as_manifold(parts["b"]))
    surface = Extraction(union, parts, 0, 0.0, 1, 0, 0.0)

    def closed() -> dict[tuple[int, int, int], bool]:
        shown = [node for node in nodes.there.values() if node.visible]
        return {node.color: is_closed(weld(Mesh(node.vertices, node.faces.astype(np.int32)), 1e-6)) for node in shown}

    stage.show_surface(surface, cage, COLOURS, set(), "Parts")
    assert closed() == {COLOURS["a"]: False, COLOURS["b"]: False}, "one surface, cut into its parts"
    stage.show_surface(surface, cage, COLOURS, {"a"}, "Parts")
    assert closed() == {COLOURS["b"]: True}
    stage.show_surface(surface, cage, COLOURS, {"gone"}, "Parts")
    assert closed() == {COLOURS["a"]: False, COLOURS["b"]: False}
