"""Files of `cagesdf fit`: a shape outside the training set, as a network represents it.

cuboids.parquet, programs.parquet   as fit_cuboids writes them, for one shape
latent.safetensors                  latent (d); residual (p, k): what is added to the code of each part
surface.ply                         the surface, in the user's frame and unit
report.json                         the verdict, and the distances from the shape
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxtyping import Float
from safetensors.torch import save
from torch import Tensor

from cagesdf.cage_fitting.fitted import FittedCage
from cagesdf.errors import InputError
from cagesdf.exported import ExportedShape
from cagesdf.io.cuboids import write_cuboids
from cagesdf.io.exports import write_export
from cagesdf.io.weights import read_header, read_tensors

FILES = ("cuboids.parquet", "programs.parquet", "latent.safetensors", "surface.ply", "report.json")
LATENT = "latent.safetensors"


def write_fit(
    folder: Path,
    fitted: FittedCage,
    latent: Float[Tensor, " d"],
    residual: Float[Tensor, "p k"],
    surface: ExportedShape,
    report: Mapping[str, Any],
) -> None:
    """Write FILES into an existing folder; `cuboids.parquet` is canonical. `report` names the shape."""
    write_cuboids(folder, {report["shape_id"]: fitted})
    tensors = {"latent": latent, "residual": residual}
    (folder / LATENT).write_bytes(save({name: value.detach().cpu().contiguous() for name, value in tensors.items()}))
    write_export(folder / "surface.ply", surface)
    text = json.dumps(report, indent=1, ensure_ascii=False) + "\n"
    (folder / "report.json").write_text(text, encoding="utf-8", newline="\n")


def read_fit_latent(folder: Path) -> tuple[Float[Tensor, " d"], Float[Tensor, "p k"]]:
    """A fitted shape's latent and its parts' residuals. Raises InputError for a file that isn't one of ours."""
    path = folder / LATENT
    if not path.is_file():
        raise InputError(f"{path}: no such file; wanted a folder that `cagesdf fit` wrote")
    sizes, _ = read_header(path)
    if {name: len(size) for name, size in sizes.items()} != {"latent": 1, "residual": 2}:
        raise InputError(
            f"{path}: holds {str(sizes)[:200]}, wanted latent (d) and residual (p, k); run `cagesdf fit` again"
        )
    tensors = read_tensors(path, sizes)
    return tensors["latent"], tensors["residual"]
