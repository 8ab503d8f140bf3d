"""`features/`: the classifier whose features generated shapes are compared in.

features.safetensors  the PointNet's weights, float32; sizes and classes in the metadata
accuracy.json         how many shapes it was not trained on it recognises
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors
from jaxtyping import Float
from numpy import ndarray
from safetensors.torch import load_file, save

from cagesdf.errors import InputError
from cagesdf.models.pointnet import PointNet

KIND = "features"
VERSION = 1
KEY = "cagesdf"
FILE = "features.safetensors"


@dataclass(frozen=True, eq=False)
class Features:
    """A trained classifier of shapes."""

    model: PointNet  # in eval mode, its parameters without gradients
    widths: tuple[int, ...]  # of the points' layers; the last is the number of features
    hidden: int  # units of the classifier
    classes: tuple[str, ...]  # in the order of the logits: a category, or <category>/<family>
    points: int  # of each cloud, that it is to be given

    def category(self, number: int) -> str:
        """The category of a class."""
        return self.classes[number].split("/")[0]

    @property
    def categories(self) -> set[str]:
        """The categories of all classes."""
        return {self.category(number) for number in range(len(self.classes))}

    def taken(self, points: Float[ndarray, "n p 3"]) -> Float[ndarray, "n q 3"]:
        """As many points of each cloud as the classifier is to be given. Raises InputError if there are fewer."""
        if points.shape[1] < self.points:
            raise InputError(f"features: wanted clouds of at least {self.points} points, got {points.shape[1]}")
        return points[:, : self.points]


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
    """What `write_features` was told of the classifier's accuracy. Raises InputError for a missing or damaged file."""
    path = folder / "accuracy.json"
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: can't be read ({error}); rerun train_features") from error


def read_features(path: Path) -> Features:
    """A classifier from a file as `write_features` writes it, trained here or elsewhere.

    Raises InputError, with the file's name, for one that is missing, damaged or something else, and for weights
    that aren't finite or don't have the sizes that the file says.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; wanted a classifier's weights as train_features writes them")
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            about = json.loads((file.metadata() or {})[KEY])
        kind, version = about["kind"], about["version"]
        widths, hidden, points = tuple(map(int, about["widths"])), int(about["hidden"]), int(about["points"])
        classes, weights = tuple(map(str, about["classes"])), load_file(path)
    except (safetensors.SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is no classifier of this project ({error!r})") from error
    if (kind, version) != (KIND, VERSION):
        raise InputError(f"{path}: holds {kind} version {version}, wanted {KIND} version {VERSION}")
    if not widths or min(*widths, hidden, points, len(classes)) < 1:
        raise InputError(f"{path}: wanted widths, hidden, points and classes of at least one, got {about}")
    model = PointNet(widths, hidden, len(classes))
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        raise InputError(f"{path}: its weights are not of the sizes that it names ({error})") from error
    if not all(bool(tensor.isfinite().all()) for tensor in weights.values()):
        raise InputError(f"{path}: has weights that are NaN or infinite")
    return Features(model.eval().requires_grad_(False), widths, hidden, classes, points)
