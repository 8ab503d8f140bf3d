"""New shapes before an outside judge: a PointNet that was trained on ModelNet40, not by us.

    python -m benchmarks.judging WEIGHTS [data] [--categories chair table vase]

`WEIGHTS` is a state dictionary of learnt 1024–512–256–40 numbers as learning3d's classifier has it; it is read without
pickled code and never shipped. Prints a Markdown table: for each arm and method the share of new shapes that the judge
calls by the name of their category, and FD and KPD of its 256 last features against the reference shapes; first the
same of the training shapes. The judge was trained on shapes that may face another way: of four turns about y it
sees the one in which it recognises most references. Both sets of FD are small: see the training shapes' for its bias.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor
from torch.nn.functional import batch_norm, linear

from cagesdf.evaluation.shape_sets import feature_figures
from cagesdf.io.clouds import read_clouds
from cagesdf.io.generated_shapes import read_generated

CLASSES = {"chair": 8, "table": 33, "vase": 37}  # ModelNet40's, in alphabetical order
POINTS = 1024
TURNS = (0, 90, 180, 270)  # degrees about y


class Judge:
    """A PointNet classifier with batch normalisation; from clouds to features and classes."""

    def __init__(self, path: Path) -> None:
        self.weights: dict[str, Tensor] = torch.load(path, weights_only=True, map_location="cpu")

    def __call__(self, clouds: Float[ndarray, "n p 3"]) -> tuple[Float[ndarray, "n 256"], ndarray]:
        """Features before the last layer, and the class of each cloud, which is centred and scaled to radius 1."""
        points = torch.from_numpy(np.ascontiguousarray(clouds[:, :POINTS], np.float32))
        points = points - points.mean(dim=1, keepdim=True)
        values = points / points.norm(dim=2).amax(dim=1)[:, None, None].clamp(min=1e-9)
        for i in range(1, 6):
            values = self._layer(values, f"feature_model.conv{i}", f"feature_model.bn{i}")
        values = values.amax(dim=1)
        for i in (1, 2):
            values = self._layer(values, f"linear{i}", f"bn{i}")
        logits = linear(values, self.weights["linear3.weight"], self.weights["linear3.bias"])
        return values.numpy(), logits.argmax(dim=1).numpy()

    def _layer(self, values: Tensor, product: str, norm: str) -> Tensor:
        weights = self.weights
        out = linear(values, weights[f"{product}.weight"].flatten(1), weights[f"{product}.bias"])
        scaled = batch_norm(
            out.flatten(0, -2),
            weights[f"{norm}.running_mean"],
            weights[f"{norm}.running_var"],
            weights[f"{norm}.weight"],
            weights[f"{norm}.bias"],
        )
        return scaled.relu().view(out.shape)


def turned(clouds: Float[ndarray, "n p 3"], degrees: int) -> Float[ndarray, "n p 3"]:
    """Clouds turned about y."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return clouds @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]], clouds.dtype)


def rows(judge: Judge, data: Path, category: str) -> list[str]:
    """The table's rows of one category."""
    sets = read_clouds(data / "clouds" / category)
    reference = sets["reference"].points
    number = CLASSES[category]
    turn = max(TURNS, key=lambda degrees: int((judge(turned(reference, degrees))[1] == number).sum()))
    features, classes = judge(turned(reference, turn))
    named = f"{category}, turned by {turn}°: {np.mean(classes == number):.0%} of {len(classes)} references"
    made = {"training shapes": np.asarray(sets["train"].points)}
    for folder in sorted((data / "generated" / category).iterdir()):
        generated = read_generated(folder)
        for method in generated.methods:
            whole = [cloud[:POINTS] for cloud in generated.points(method).values() if len(cloud) >= POINTS]
            if len(whole) > 1:
                made[f"`{folder.name}`, {method}"] = np.stack(whole)
    table = []
    for name, clouds in made.items():
        judged, predicted = judge(turned(clouds, turn))
        figures = feature_figures(judged, features)
        share = np.mean(predicted == number)
        table.append(f"| {named} | {name} | {len(clouds)} | {share:.0%} | {figures['fd']:.3g} | {figures['kpd']:.3g} |")
    return table


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path)
    parser.add_argument("data", type=Path, nargs="?", default=Path("data"))
    parser.add_argument("--categories", nargs="+", default=list(CLASSES))
    options = parser.parse_args()
    judge = Judge(options.weights)
    print("| references | shapes | n | recognised | FD | KPD |\n|---|---|---|---|---|---|")
    for category in options.categories:
        print("\n".join(rows(judge, options.data, category)), flush=True)


if __name__ == "__main__":
    main()
