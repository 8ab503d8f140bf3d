"""Who may import whom: docs/design.md, section 3, read off the code's own imports."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
RECORDS = {"errors", "frames", "cuboid", "meshes", "shape", "structure"}
SOLIDS = {"errors", "frames", "cuboid", "meshes", "solid", "distance"}
# A file or folder of cagesdf, and what else of cagesdf it may import.
ALLOWED = {
    "errors": set(),
    "frames": {"errors"},
    "cuboid": {"errors", "frames"},
    "meshes": {"errors"},
    "distance": {"errors", "meshes"},
    "coverage": {"meshes", "distance"},
    "meshlab": {"errors"},
    "solid": {"errors", "meshes", "cuboid", "distance", "coverage", "meshlab"},
    "structure": {"errors", "frames", "cuboid"},
    "shape": {"frames", "meshes", "structure"},
    "alignment": RECORDS,
    "formats": RECORDS | {"alignment"},
    "audit": RECORDS | SOLIDS,
    "importing": RECORDS | SOLIDS | {"audit"},
    "synthesis": RECORDS | SOLIDS,
    "fitting": RECORDS | SOLIDS,
    "matching": RECORDS | SOLIDS,
    "deformation": RECORDS | SOLIDS | {"matching"},
    "sampling": RECORDS | SOLIDS | {"deformation"},
    "models": {"errors"},
    "generation": RECORDS | {"matching"},
    "stability": RECORDS | {"matching"},
    "simulation": RECORDS | {"stability"},
    "io": RECORDS | {"fitting", "matching", "models", "evaluation", "generation"},
    "training": RECORDS | {"models", "io"},
    "extraction": RECORDS | SOLIDS | {"models"},
    "editing": RECORDS | {"solid", "deformation", "io", "extraction"},
    "evaluation": RECORDS | SOLIDS | {"matching", "deformation", "synthesis"},
    "inference": RECORDS | SOLIDS | {"fitting", "sampling", "io", "models", "training", "extraction", "evaluation"},
    "generating": RECORDS | {"generation", "stability", "simulation", "io", "extraction"},
    "rendering": RECORDS | SOLIDS,
    "demo": set(),
    "viewing": RECORDS
    | {"editing", "generation", "generating", "inference", "formats", "io", "extraction", "rendering"},
    "report": RECORDS | SOLIDS | {"rendering", "evaluation", "deformation", "io"},
}
TORCH = {
    "models",
    "training",
    "extraction",
    "inference",
    "generating",
    "generation/batching.py",
    "generation/program_vae.py",
    "generation/training.py",
    "generation/decoding.py",
    "generation/programs.py",
    "generation/recurrent.py",
    "io/features.py",
    "io/fits.py",
    "io/generators.py",
    "io/runs.py",
    "editing/session.py",
    "cli",
}
PYARROW = {"io"}
YAML = {"params.py", "planning.py", "workspace.py"}


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Every dotted module name that a file imports, at any depth."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module or ""}
    return names


def tops(path: Path, package: str) -> set[str]:
    """The files or folders of `package` that a file imports."""
    return {name.split(".")[1] for name in imported(path) if name.startswith(package + ".")}


def room(path: Path) -> str:
    """The file or folder of its package that a path belongs to."""
    return path.relative_to(ROOT).parts[1].removesuffix(".py")


@pytest.mark.parametrize("path", modules("cagesdf"), ids=lambda path: str(path.relative_to(ROOT)))
def test_the_library_imports_only_what_lies_before_it(path: Path) -> None:
    names = imported(path)
    assert not {name for name in names if name.split(".")[0] == "stages"}
    if room(path) in ("cli", "__init__"):
        return
    assert not {name for name in names if name.split(".")[0] == "pipeline"}
    assert room(path) in ALLOWED, f"give {room(path)} a place in ALLOWED and in docs/design.md"
    assert tops(path, "cagesdf") <= ALLOWED[room(path)] | {room(path)}


@pytest.mark.parametrize("path", modules("pipeline"), ids=lambda path: path.name)
def test_the_machinery_knows_nothing_about_shapes(path: Path) -> None:
    assert not {name for name in imported(path) if name.split(".")[0] in ("cagesdf", "stages")}


@pytest.mark.parametrize("path", modules("stages"), ids=lambda path: path.name)
def test_stages_never_import_stages(path: Path) -> None:
    assert not {name for name in imported(path) if name.split(".")[0] == "stages"}


@pytest.mark.parametrize("path", modules("cagesdf"), ids=lambda path: str(path.relative_to(ROOT)))
def test_torch_pyarrow_and_yaml_stay_in_their_places(path: Path) -> None:
    packages = {name.split(".")[0] for name in imported(path)}
    inside = path.relative_to(ROOT / "cagesdf").as_posix()
    assert "torch" not in packages or room(path) in TORCH or inside in TORCH
    assert "pyarrow" not in packages or room(path) in PYARROW | {"cli"}
    assert "yaml" not in packages


def test_only_the_parameter_files_read_yaml() -> None:
    readers = {path.name for path in modules("pipeline") + modules("stages") if "yaml" in imported(path)}
    assert readers <= YAML


def test_the_library_is_free_of_postponed_annotations() -> None:
    """They would switch the shape checks of jaxtyping off."""
    assert not [path for path in modules("cagesdf") if "__future__.annotations" in imported(path)]
