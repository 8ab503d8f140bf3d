"""Furniture libraries of Sweet Home 3D: sizes from the catalogue, and nothing that leads out of the zip."""

import zipfile
from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError, ShapeRejected
from cagesdf.formats import sh3f
from cagesdf.formats.listing import find_shape, find_shapes, list_shapes, read_shape
from cagesdf.formats.sh3f import CATALOGUE, piece_names, properties, read_piece
from tests.support import toy

REAL = Path(__file__).parents[3] / "shared" / "data" / "real" / "sweethome3d_cc0"
STOOL = {
    "name": "Tabouret \\u00e9t\\u00e9",
    "model": "/models/stool.obj",
    "width": "40",
    "depth": "30",
    "height": "45.5",
}


def obj(*groups: tuple[str, tuple[float, ...], tuple[float, ...]]) -> str:
    """Boxes by name, centre and size."""
    lines, start = [], 1
    for name, centre, size in groups:
        mesh = toy.box([*centre], [*size])
        lines += [f"g {name}", *(f"v {x} {y} {z}" for x, y, z in mesh.vertices.tolist())]
        lines += ["f " + " ".join(str(i + start) for i in face) for face in mesh.faces.tolist()]
        start += len(mesh.vertices)
    return "\n".join(lines)


MODEL = obj(("seat", (0, 0.9, 0), (1, 0.2, 1)), ("leg", (0, 0.4, 0), (0.2, 0.8, 0.2)))


def library(path: Path, *pieces: dict[str, str], **members: str) -> Path:
    lines = [f"{key}#{i}={value}" for i, piece in enumerate(pieces, 1) for key, value in piece.items()]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(CATALOGUE, "\n".join(["# a library", "id=toy", *lines]).encode("latin-1"))
        archive.writestr("models/stool.obj", MODEL)
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def box(path: Path, place: int = 0) -> tuple[list[float], list[float]]:
    vertices = np.concatenate([part.mesh.vertices for part in read_piece(path, place, "a", "train").parts])
    return vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()


def test_a_piece_has_its_catalogues_lengths_and_its_models_groups(tmp_path: Path) -> None:
    path = library(tmp_path / "a.sh3f", STOOL)
    assert piece_names(path) == ["Tabouret été"]
    shape = read_piece(path, 0, "a", "val")
    assert ([part.part_id for part in shape.parts], shape.split, shape.whole) == (["seat", "leg"], "val", True)
    assert box(path) == (pytest.approx([-20, 0, -15]), pytest.approx([20, 45.5, 15]))
    seat = shape.parts[0].mesh.vertices
    assert np.ptp(seat[:, 1]) == pytest.approx(0.2 * 45.5)


def test_a_turned_model_is_turned_before_it_is_stretched(tmp_path: Path) -> None:
    lying = STOOL | {"modelRotation": "1 0 0 0 0 1 0 -1 0"}  # what was along z is up
    path = library(tmp_path / "a.sh3f", lying)
    assert box(path) == (pytest.approx([-20, 0, -15]), pytest.approx([20, 45.5, 15]))
    seat = read_piece(path, 0, "a", "train").parts[0].mesh.vertices
    assert np.ptp(seat, axis=0)[1:] == pytest.approx([45.5, 0.2 * 30])


def test_flat_models_stay_flat(tmp_path: Path) -> None:
    flat = STOOL | {"model": "flat.obj"}
    path = library(tmp_path / "a.sh3f", flat, **{"flat.obj": "v 0 0 0\nv 1 0 0\nv 1 2 0\nf 1 2 3"})
    assert box(path) == (pytest.approx([-20, 0, 0]), pytest.approx([20, 45.5, 0]))


def test_pieces_are_shapes_of_the_folder_that_holds_the_library(tmp_path: Path) -> None:
    names = ("chair", "chair", "../../etc/passwd", "C:\\\\chair", ".hidden", "")
    library(tmp_path / "b.sh3f", *(STOOL | {"name": name} for name in names))
    (tmp_path / "alone.obj").write_text(MODEL)
    (tmp_path / "broken.sh3f").write_text("no zip")
    listing = list_shapes(tmp_path, "*")
    ids = [source.shape_id for source in listing]
    assert ids == sorted(["alone", "b_chair", "b_chair_2", "b__etc_passwd", "b_C:_chair", "b_hidden", "b_part"])
    assert not any("/" in i or "\\" in i for i in ids)
    assert "broken.sh3f: can't be read as a zip" in " ".join(listing.notes)
    shapes = [read_shape(source) for source in listing]
    assert [(shape.shape_id, len(shape.parts)) for shape in shapes] == [(i, 2) for i in ids]
    assert [source.shape_id for source in find_shapes(tmp_path / "b.sh3f", "*_2")] == ["b_chair_2"]
    with pytest.raises(InputError, match="6 pieces, such as"):
        find_shape(tmp_path / "b.sh3f")


def test_a_file_of_parts_beside_a_library_is_no_pieces(tmp_path: Path) -> None:
    library(tmp_path / "b.sh3f", STOOL)
    (tmp_path / "b.parts.json").write_text("{}")
    [source] = list_shapes(tmp_path, "*")
    assert source.written is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "../outside.obj"}, "holds no '../outside.obj'"),
        ({"model": "/etc/passwd"}, "wanted an .obj file within the library"),
        ({"model": "https://example.org/a.obj"}, "holds no"),
        ({"width": "-1"}, "width#1 is '-1'; wanted centimetres"),
        ({"depth": "nan"}, "wanted 1 finite"),
        ({"height": "1e300"}, "wanted 1 finite"),
        ({"height": "four"}, "height#1: 'four': wanted a number"),
        ({"modelRotation": "1 0 0 0 1 0 0 0 -1"}, "is no rotation"),
        ({"modelRotation": "1 0 0"}, "wanted 9 finite"),
    ],
)
def test_a_piece_that_can_not_be_is_rejected_with_the_reason(
    change: dict[str, str], message: str, tmp_path: Path
) -> None:
    (tmp_path.parent / "outside.obj").write_text(MODEL)
    path = library(tmp_path / "a.sh3f", STOOL | change)
    with pytest.raises(ShapeRejected, match=message):
        read_shape(find_shape(path))


def test_members_are_unpacked_up_to_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = library(tmp_path / "a.sh3f", STOOL | {"model": "large.obj"}, **{"large.obj": "#" * 10_000})
    monkeypatch.setattr(sh3f, "MAX_BYTES", 9_999)
    with pytest.raises(InputError, match="has more than 9,999 bytes"):
        read_piece(path, 0, "a", "train")
    monkeypatch.setattr(sh3f, "MAX_CATALOGUE", 10)
    with pytest.raises(InputError, match="has more than 10 bytes"):
        piece_names(path)


def test_a_damaged_library_is_refused_in_words_wherever_it_is_damaged(tmp_path: Path) -> None:
    whole = library(tmp_path / "a.sh3f", STOOL).read_bytes()
    rng, refusals = np.random.default_rng(0), []
    for _ in range(200):
        content = bytearray(whole)
        for at in rng.integers(len(whole), size=3):
            content[at] = rng.integers(256)
        path = tmp_path / "b.sh3f"
        path.write_bytes(bytes(content[: rng.integers(len(whole) // 2, len(whole) + 1)]))
        try:
            read_piece(path, 0, "a", "train")
        except InputError as error:
            refusals.append(str(error))
    assert len(refusals) > 100
    assert all(str(path) in refusal for refusal in refusals)


def test_properties_are_javas() -> None:
    text = (
        "# none = 1\n! none = 2\r\na=1\n b : two words \nc three\\\n    and more\nd\\=e\\ f=\\u00e9\\t\\\\\nempty=\n\\"
    )
    assert properties(text) == {
        "a": "1", "b": "two words ", "c": "threeand more", "d=e f": "é\t\\", "empty": "",
    }  # fmt: skip


@pytest.mark.skipif(not REAL.is_dir(), reason="needs the real furniture")
def test_real_models_have_their_catalogues_lengths(tmp_path: Path) -> None:
    models = sorted(REAL.glob("cabinet/*.obj"), key=lambda path: path.stat().st_size)[:3]
    pieces = [STOOL | {"name": path.stem, "model": path.name} for path in models]
    contents = {path.name: path.read_text(encoding="utf-8") for path in models}
    path = library(tmp_path / "real.sh3f", *pieces, **contents)
    for i in range(len(models)):
        assert box(path, i) == (pytest.approx([-20, 0, -15]), pytest.approx([20, 45.5, 15]))
