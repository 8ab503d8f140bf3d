"""A whole mesh whose parts are changed by hand, before the network has seen them and after."""

import numpy as np
import pytest

from cagesdf.api.sources import IMPORT
from cagesdf.editing.document import Document
from cagesdf.editing.script import Build, Move, Style
from cagesdf.editing.session import Session
from cagesdf.geometry.meshes import join
from cagesdf.importing import import_shape
from cagesdf.parts.changing import Dissection
from cagesdf.shape import RawPart, RawShape
from cagesdf.structure.hierarchy import PartHierarchy
from cagesdf.viewing.dissecting import plane_through
from cagesdf.viewing.uploads import Upload
from tests.support import toy

MESH = join([toy.box([10, 0, 0], [1, 0.1, 1]), *(toy.box([10 + x, -0.5, 0], [0.1, 0.8, 0.1]) for x in (-0.4, 0.4))])
RAW = RawShape("stool", "train", (RawPart("stool", "", MESH),), PartHierarchy.flat(("stool",), ("",), ""), whole=True)
STYLE = Style(code=(0.5, -0.25, 0.125, 1.0))


@pytest.fixture
def upload() -> Upload:
    shape = import_shape(RAW, **IMPORT)
    return Upload("stool.obj", RAW, join([part.mesh for part in shape.parts]), shape.origin)


@pytest.fixture
def found() -> Dissection:
    return Dissection.of(RAW, IMPORT["up"], IMPORT["weld"], IMPORT["min_thickness"])


@pytest.fixture
def first(session: Session) -> Document:
    return Document.opened("a", session.opened("a"))


def test_parts_are_those_that_an_import_finds(found: Dissection, upload: Upload) -> None:
    assert upload.origin.parts == "found"
    assert [part.part_id for part in import_shape(RAW, **IMPORT).parts] == list(found.cage().part_ids)


def test_the_parts_shown_are_those_of_the_state_through_undo_and_redo(
    session: Session, found: Dissection, upload: Upload, first: Document
) -> None:
    styles = session.styles
    came_in = first.then(upload.build(found), styles).then(STYLE, styles)
    assert upload.newest(came_in) is found
    assert upload.unfitted(came_in) is None
    merged = found.changed(["merge part_2 part_3"])
    changed = came_in.then(upload.build(merged), styles)
    assert upload.unfitted(changed) is merged
    assert changed.state.cage.part_ids == ("part_1", "part_2")
    np.testing.assert_allclose(changed.state.similarity.scale, found.placement.scale)
    split = merged.changed(["split part_1 x 10.1"])
    again = changed.then(upload.build(split), styles)
    assert upload.unfitted(again) is split
    assert upload.unfitted(again.undone(styles)) is merged
    assert upload.unfitted(again.undone(styles).undone(styles)) is None
    assert upload.newest(again.undone(styles).undone(styles)) is found
    assert upload.unfitted(again.undone(styles).redone(styles)) is split
    fitted = again.then(STYLE, styles)
    assert upload.unfitted(fitted) is None
    moved = fitted.then(Move(part="part_1", by=(0.1, 0.0, 0.0)), styles)
    assert upload.newest(moved) is split


def test_a_document_from_elsewhere_has_none(session: Session, upload: Upload, first: Document) -> None:
    assert upload.newest(first) is None
    built = first.then(Build(structure=session.opened("b").structure.to_json()), session.styles)
    assert upload.newest(built) is None
    assert upload.unfitted(built) is None


def test_a_file_that_grew_is_counted(upload: Upload, found: Dissection) -> None:
    before = upload.bytes
    upload.build(found)
    assert upload.bytes == before + MESH.vertices.nbytes + MESH.faces.nbytes


def test_the_plane_is_across_the_file_s_axis_and_covers_the_part(
    session: Session, found: Dissection, upload: Upload, first: Document
) -> None:
    state = first.then(upload.build(found), session.styles).state
    for axis, place in zip("xyz", (10.1, 0.02, -0.2)):
        corners = state.similarity.to_raw(plane_through(state, "part_1", axis, place))
        row = "xyz".index(axis)
        np.testing.assert_allclose(corners[:, row], place, atol=1e-9)
        part = state.similarity.to_raw(state.cage.corners()[0])
        others = [other for other in range(3) if other != row]
        assert (corners.min(axis=0)[others] < part.min(axis=0)[others]).all()
        assert (corners.max(axis=0)[others] > part.max(axis=0)[others]).all()
        assert np.linalg.norm(np.cross(corners[1] - corners[0], corners[3] - corners[0])) > 0
