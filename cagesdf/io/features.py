"""`features/`: the classifier whose features generated shapes are compared in.

features.safetensors  the PointNet's weights, float32; sizes and classes in the metadata
accuracy.json         how many shapes it was not trained on it recognises
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save

from cagesdf.errors import InputError
from cagesdf.io.weights import (
    MAX_WIDTH,
    filled,
    parse_description,
    planned,
    read_description,
    read_header,
    read_tensors,
    sizes_of,
    whole,
    wholes,
)
from cagesdf.models.features import Features
from cagesdf.models.pointnet import PointNet

KIND = "features"
VERSION = 1
KEY = "cagesdf"
FILE = "features.safetensors"
MAX_CLASSES = 100_000
MAX_POINTS = 1_000_000  # of a cloud


def write_features(folder: Path, features: Features, accuracy: Mapping[str, Any]) -> None:
    """Write the classifier and its accuracy into an existing folder."""
    weights = {name: tensor.detach().cpu().contiguous() for name, tensor in features.model.state_dict().items()}
    about = {
        "kind": KIND,
        "version": VERSION,
        "widths": features.widths,
        "hidden": features.hidden,
        "classes": features.classes,
        "points": features.points,
    }
    (folder / FILE).write_bytes(save(weights, {KEY: json.dumps(about, sort_keys=True)}))
    text = json.dumps(dict(accuracy), indent=1, sort_keys=True) + "\n"
    (folder / "accuracy.json").write_text(text, encoding="utf-8", newline="\n")


def read_accuracy(folder: Path) -> dict[str, Any]:
    """The classifier's accuracy as `write_features` stored it. Raises InputError for a missing or damaged file."""
    return read_description(folder / "accuracy.json")


def read_features(path: Path) -> Features:
    """A classifier from a file as `write_features` writes it, trained here or elsewhere.

    Raises InputError, with the file's name, for one that is missing, damaged or something else, for sizes out of
    bounds, and for weights that aren't finite or don't have the sizes that the file says.
    """
    _, metadata = read_header(path)
    if KEY not in metadata:
        raise InputError(f"{path}: is no classifier of this project, its metadata have no {KEY}")
    about = parse_description(metadata[KEY], path)
    if about.get("kind") != KIND or about.get("version") != VERSION:
        got = f"{about.get('kind')!s:.60} version {about.get('version')!s:.60}"
        raise InputError(f"{path}: holds {got}, wanted {KIND} version {VERSION}")
    widths, hidden = wholes(about, "widths", 1, MAX_WIDTH, path), whole(about, "hidden", 1, MAX_WIDTH, path)
    points, classes = whole(about, "points", 1, MAX_POINTS, path), about.get("classes")
    if not widths:
        raise InputError(f"{path}: wanted widths of at least one layer, got none")
    if not isinstance(classes, list) or not 1 <= len(classes) <= MAX_CLASSES or not {*map(type, classes)} <= {str}:
        raise InputError(f"{path}: wanted 1 to {MAX_CLASSES:,} names of classes, got {str(classes)[:60]}")
    model = planned(lambda: PointNet(widths, hidden, len(classes)))
    return Features(filled(model, read_tensors(path, sizes_of(model))), widths, hidden, tuple(classes), points)
