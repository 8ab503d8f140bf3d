"""PartNet's trees and StructureNet's hierarchies, joined by the ids of their nodes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagesdf.errors import ShapeRejected
from cagesdf.formats.listing import list_shapes, read_shape
from cagesdf.shape import RawShape
from tests.support import toy

REAL = Path(__file__).parents[3] / "shared/data/partnet"


def node(number: int, name: str, objs: list[str], *children: dict) -> dict:
    entry: dict[str, Any] = {"id": number, "name": name, "text": name, "objs": objs}
    return entry | ({"children": list(children)} if children else {})


TREE = node(
    0, "chair", ["o-0", "o-1", "o-2", "o-3", "n-4"],
    node(1, "chair_seat", ["o-0"]),
    node(2, "chair_base", ["o-1", "o-2", "o-3"], node(3, "leg", ["o-1"]), node(4, "leg", ["o-2"])),
)  # fmt: skip


def write(folder: Path, tree: object, hierarchy: object = None, meshes: str = "objs") -> None:
    for i, name in enumerate(["o-0", "o-1", "o-2", "o-3", "n-4"]):
        toy.write_obj(folder / "7" / meshes / f"{name}.obj", toy.box([2 * i, 0, 0], [1, 1, 1]))
    (folder / "7" / "result_after_merging.json").write_text(json.dumps(tree))
    if hierarchy is not None:
        (folder / "chair_hier").mkdir()
        (folder / "chair_hier" / "7.json").write_text(json.dumps(hierarchy))


def read(folder: Path) -> RawShape:
    (source,) = list_shapes(folder, "*")
    return read_shape(source)


def places(shape: RawShape) -> dict[str, list[float]]:
    """Which of the boxes, by their number, each part has."""
    return {part.part_id: sorted({round(x / 2) for x in part.mesh.vertices[:, 0]}) for part in shape.parts}


@pytest.mark.parametrize("meshes", ["objs", "textured_objs"])
def test_without_a_hierarchy_the_tree_is_the_structure_and_unlabelled_meshes_are_others(
    tmp_path: Path, meshes: str
) -> None:
    write(tmp_path, [TREE], meshes=meshes)
    shape = read(tmp_path)
    assert places(shape) == {"1": [0], "3": [1], "4": [2], "-1@2": [3], "-1@0": [4]}
    assert shape.structure.labels() == {"1": "chair_seat", "3": "leg", "4": "leg", "-1@2": "other", "-1@0": "other"}
    assert shape.structure.children("2") == ("3", "4", "-1@2")


def test_the_hierarchy_says_what_the_parts_are(tmp_path: Path) -> None:
    """Its leaf may stand for a subtree; its remainders have the id -1."""
    box = [0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 1, 0]
    edge = {"part_a": 0, "part_b": 1, "type": "ADJ", "dist": 0.5}
    children = [
        {"id": 2, "label": "base", "box": box},
        {"id": 1, "label": "seat", "box": box},
        {"id": -1, "label": "other", "box": box},
    ]
    write(tmp_path, [TREE], {"id": 0, "label": "chair", "children": children, "edges": [edge]})
    shape = read(tmp_path)
    assert places(shape) == {"2": [1, 2, 3], "1": [0], "-1": [4]}
    assert [part.label for part in shape.parts] == ["base", "seat", "other"]
    assert len(shape.structure.relations()) == 1
    assert set(shape.structure.cage().part_ids) == {"2", "1", "-1"}


@pytest.mark.parametrize(
    ("tree", "hierarchy", "reason"),
    [
        ([TREE], {"id": 0, "label": "x", "children": [{"id": 9, "label": "arm"}]}, r"leaf 9 \(arm\) has no mesh"),
        (
            [TREE],
            {"id": 0, "children": [{"id": 1}, {"id": 3}, {"id": 5, "children": [{"id": -1}]}]},
            "leaf -1 .* no mesh",
        ),
        ([TREE], [], "wanted an object with an id"),
        ([TREE, TREE], None, "one root, got 2"),
        ([node(0, "x", ["missing"])], None, r"lacks 1 of the 1 meshes .*: missing\.obj of node 0 \(x\)"),
        ([node(0, "x", ["../../secret"])], None, "must be a list of file names"),
        ([node(0, "x", [], node(0, "y", ["o-1"]))], None, "two nodes have the id 0"),
        ([node(0, "x", [])], None, "has no mesh"),
        (["x"], None, "wanted a node with an id"),
    ],
)
def test_what_does_not_fit_together_rejects_the_shape(tmp_path: Path, tree, hierarchy, reason: str) -> None:
    write(tmp_path, tree, hierarchy)
    with pytest.raises(ShapeRejected, match=reason):
        read(tmp_path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32-be"])
def test_trees_and_hierarchies_are_read_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    tree = [node(0, "chair", ["o-0"], node(1, "椅子", ["o-0"]))]
    write(tmp_path, tree, {"id": 0, "label": "chair", "children": [{"id": 1, "label": "Stühl"}]})
    for path in (tmp_path / "7" / "result_after_merging.json", tmp_path / "chair_hier" / "7.json"):
        content = json.loads(path.read_text())
        path.write_bytes(json.dumps(content, ensure_ascii=False).encode(encoding))
    assert [part.label for part in read(tmp_path).parts] == ["Stühl"]
    (tmp_path / "chair_hier" / "7.json").write_bytes('{"id": 0,\n"label": "Stühl"}'.encode("latin-1"))
    with pytest.raises(ShapeRejected, match=r"7\.json, line 2: is no text in UTF-8 .*; save it as UTF-8"):
        read(tmp_path)


def test_broken_json_and_a_missing_mesh_folder_reject_the_shape(tmp_path: Path) -> None:
    write(tmp_path, [TREE])
    (tmp_path / "7" / "objs").rename(tmp_path / "7" / "meshes")
    with pytest.raises(ShapeRejected, match="neither objs nor textured_objs"):
        read(tmp_path)
    for text in ('[{"id": 0', "[" * 100_000):
        (tmp_path / "7" / "result_after_merging.json").write_text(text)
        with pytest.raises(ShapeRejected, match="no readable JSON"):
            read(tmp_path)


@pytest.mark.skipif(not REAL.is_dir(), reason="needs the real PartNet shape")
def test_the_real_bottle_has_its_three_parts() -> None:
    shape = read(REAL)
    assert [(part.part_id, part.label) for part in shape.parts] == [("2", "body"), ("3", "neck"), ("4", "lid")]
    heights = [np.ptp(part.mesh.vertices[:, 1]) for part in shape.parts]
    assert heights[0] > heights[2] > heights[1]
