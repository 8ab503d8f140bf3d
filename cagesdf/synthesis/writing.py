"""Procedural shapes on disk, in the layout of the real data sets: PartNet, StructureNet and ShapeAssembly.

<shape_id>/objs/original-<n>.obj     one mesh a part
<shape_id>/result_after_merging.json the part tree; a node's id is its place in preorder
<shape_id>/meta.json
<shape_id>/recipe.json               what the shape was made from, and which parts are defective
<category>_hier/<shape_id>.json      the hierarchy with boxes and relations
<category>_programs/<shape_id>.txt   the program, where the category has programs
train.txt, val.txt                   one id a line
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cagesdf.geometry.meshes import Mesh
from cagesdf.structure.hierarchy import Node
from cagesdf.synthesis.dataset import assemble, build, draw
from cagesdf.synthesis.recipe import Recipe

DEFECTS = ("opened", "flipped", "doubled")
OBJ_DIGITS = 7  # after the point
OPENED = 0.03  # share of the faces that an opened part lacks, around one of them


def write_shape(folder: Path, recipe: Recipe, defective: float, rng: np.random.Generator) -> None:
    """Write one shape below the category's `folder`.

    Each part is defective with probability `defective`: opened, flipped (all faces inside out)
    or doubled (each face in the opposite winding too), as parts of real collections are.
    """
    structure = draw(recipe).structure
    place = folder / recipe.shape_id
    objs: dict[str, str] = {}
    defects: dict[str, str] = {}
    for number, part in enumerate(build(recipe, recipe), start=1):
        mesh = part.mesh
        if rng.random() < defective:
            defects[part.part_id] = DEFECTS[int(rng.integers(len(DEFECTS)))]
            mesh = with_defect(mesh, defects[part.part_id], rng)
        objs[part.part_id] = f"original-{number}"
        _write_text(place / "objs" / f"original-{number}.obj", obj_text(mesh))
    _write_json(place / "result_after_merging.json", [_partnet(structure.tree, objs)])
    _write_json(place / "meta.json", {"anno_id": recipe.shape_id, "model_cat": recipe.category})
    _write_text(place / "recipe.json", recipe.to_json(defects=defects))
    _write_json(folder / f"{recipe.category}_hier" / f"{recipe.shape_id}.json", structure.to_dict())
    assembled = assemble(recipe)
    if assembled is not None:
        _write_text(folder / f"{recipe.category}_programs" / f"{recipe.shape_id}.txt", str(assembled.program))


def write_splits(folder: Path, recipes: Sequence[Recipe]) -> None:
    """Write `train.txt` and `val.txt`."""
    for split in ("train", "val"):
        lines = [recipe.shape_id + "\n" for recipe in recipes if recipe.split == split]
        _write_text(folder / f"{split}.txt", "".join(lines))


def read_recipes(folder: Path) -> dict[str, Recipe]:
    """The recipes of a category's `folder` by shape id; none if its shapes come from elsewhere."""
    files = sorted(folder.glob("*/recipe.json"))
    return {file.parent.name: Recipe.from_json(file.read_text(encoding="utf-8")) for file in files}


def with_defect(mesh: Mesh, defect: str, rng: np.random.Generator) -> Mesh:
    """The mesh as it is often found: one of DEFECTS. Raises ValueError for another name."""
    faces = mesh.faces
    match defect:
        case "opened":
            centres = mesh.corners().mean(axis=1)
            away = np.linalg.norm(centres - centres[rng.integers(len(centres))], axis=1)
            lost = np.argsort(away, kind="stable")[: max(1, int(OPENED * len(faces)))]
            return Mesh(mesh.vertices, np.delete(faces, lost, axis=0))
        case "flipped":
            return Mesh(mesh.vertices, faces[:, ::-1].copy())
        case "doubled":
            return Mesh(mesh.vertices, np.concatenate([faces, faces[:, ::-1]]))
    raise ValueError(f"defect {defect!r}: wanted one of {', '.join(DEFECTS)}")


def obj_text(mesh: Mesh) -> str:
    """A mesh as an OBJ file, OBJ_DIGITS digits after the point."""
    lines = ["v " + " ".join(f"{number:.{OBJ_DIGITS}f}" for number in vertex) for vertex in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    return "\n".join(lines) + "\n"


def _partnet(node: Node, objs: Mapping[str, str]) -> dict[str, Any]:
    """PartNet's tree: a node lists the meshes of all its descendants, leaves have no children."""
    below = [objs[leaf.node_id] for leaf in node.walk() if leaf.node_id in objs]
    number = int(node.node_id)
    entry: dict[str, Any] = {"id": number, "ori_id": number, "name": node.label, "text": node.label, "objs": below}
    if node.children:
        entry["children"] = [_partnet(child, objs) for child in node.children]
    return entry


def _write_json(path: Path, content: object) -> None:
    _write_text(path, json.dumps(content, sort_keys=True) + "\n")


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="\n")
