"""Who may import whom: docs/design.md, section 3, read off the code's own imports."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RECORDS = {"errors", "text", "frames", "cuboid", "geometry", "shape", "structure", "exported"}
# A file or folder of cagesdf, and what else of cagesdf it may import.
ALLOWED = {
    "errors": set(),
    "seeds": set(),
    "text": {"errors"},
    "frames": {"errors"},
    "cuboid": {"errors", "frames"},
    "geometry": {"errors", "frames", "cuboid"},
    "structure": {"errors", "text", "frames", "cuboid"},
    "shape": {"frames", "geometry", "structure"},
    "exported": {"errors", "geometry"},
    "audit": RECORDS,
    "parts": RECORDS | {"cage_fitting", "deformation"},
    "formats": RECORDS | {"parts"},
    "importing": RECORDS | {"audit", "parts"},
    "synthesis": RECORDS,
    "cage_fitting": RECORDS,
    "deformation": RECORDS,
    "sampling": RECORDS | {"deformation", "io"},
    "models": {"errors", "frames", "cuboid"},
    "run": RECORDS | {"models"},
    "cage_generation": RECORDS | {"deformation"},
    "shape_generation": RECORDS | {"deformation", "cage_generation", "models", "run", "extraction"},
    "io": RECORDS
    | {"cage_fitting", "deformation", "models", "run", "evaluation", "cage_generation", "shape_generation"},
    "training": RECORDS | {"models", "io"},
    "extraction": RECORDS | {"models"},
    "editing": RECORDS | {"deformation", "models", "run", "io", "extraction"},
    "evaluation": RECORDS | {"deformation", "synthesis"},
    "inference": RECORDS
    | {"cage_fitting", "deformation", "sampling", "io", "models", "run", "training", "extraction", "evaluation"},
    "rendering": RECORDS,
    "demo": set(),
    "api": RECORDS
    | {"seeds", "editing", "extraction", "cage_generation", "shape_generation", "inference"}
    | {"formats", "importing", "io", "rendering", "demo"},
    "viewing": RECORDS
    | {"editing", "cage_generation", "shape_generation", "inference", "formats", "parts", "importing"}
    | {"run", "io", "extraction", "rendering"},
    "report": RECORDS | {"rendering", "evaluation", "deformation", "io"},
}
# Inside geometry/: a file, and those of the others that it may import.
GEOMETRY = {
    "meshes": set(),
    "distance": {"meshes"},
    "coverage": {"meshes", "distance"},
    "meshlab": set(),
    "solid": {"meshes", "distance", "meshlab", "coverage"},
    "resizing": {"meshes"},
}
TORCH = {
    "models",
    "training",
    "extraction",
    "api",
    "inference",
    "run.py",
    "shape_generation/surfaces.py",
    "cage_generation/batching.py",
    "cage_generation/program_vae.py",
    "cage_generation/training.py",
    "cage_generation/decoding.py",
    "cage_generation/programs.py",
    "cage_generation/recurrent.py",
    "io/features.py",
    "io/fits.py",
    "io/cage_generators.py",
    "io/runs.py",
    "io/weights.py",
    "editing/session.py",
    "cli",
}
PYARROW = {"io"}
YAML = {"params.py", "planning.py", "workspace.py"}
NAMING_STAGES = {"params.py", "cost.py", "workspace.py"}  # of the machinery: docs/design.md, section 2
DYNAMIC = {"import_module", "__import__", "run_module", "run_path"}


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Every dotted module name that a file imports, at any depth."""
    return imports(path.read_text(encoding="utf-8"), str(path))


def imports(text: str, path: str) -> set[str]:
    """The same of a file's text; of a name that is put together as it runs, what stands before its first gap."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module or ""}
        elif isinstance(node, ast.Call) and called(node) in DYNAMIC:
            name = node.args[0].values[0] if isinstance(node.args[0], ast.JoinedStr) else node.args[0]
            assert isinstance(name, ast.Constant), f"{path}: imports what its text doesn't tell"
            names.add(str(name.value))
    return names


def called(node: ast.Call) -> str:
    """The last word of what is called."""
    return ast.unparse(node.func).split(".")[-1]


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
    pipeline = {name for name in names if name.split(".")[0] == "pipeline"}
    assert not pipeline or path.name == "planning.py", "the package is installed without it"
    if room(path) in ("cli", "__init__"):
        return
    assert room(path) in ALLOWED, f"give {room(path)} a place in ALLOWED and in docs/design.md"
    assert tops(path, "cagesdf") <= ALLOWED[room(path)] | {room(path)}


@pytest.mark.parametrize("path", modules("cagesdf/geometry"), ids=lambda path: path.name)
def test_geometry_goes_from_meshes_to_solids(path: Path) -> None:
    names = {name.split(".")[2] for name in imported(path) if name.startswith("cagesdf.geometry.")}
    assert names <= GEOMETRY.get(path.stem, set())


@pytest.mark.parametrize("path", modules("pipeline"), ids=lambda path: path.name)
def test_the_machinery_imports_nothing_of_the_library_and_only_two_files_import_stages(path: Path) -> None:
    packages = {name.split(".")[0] for name in imported(path)}
    assert "cagesdf" not in packages
    assert ("stages" in packages) == (path.name in ("lanes.py", "planning.py"))


def test_the_machinery_names_single_stages_where_the_design_says_so_and_networks_nowhere() -> None:
    stages = {path.stem for path in modules("stages")} - {"__init__", "report"}
    networks = {name for path in modules("cagesdf/models") for name in classes(path.read_text(encoding="utf-8"))}
    texts = {path.name: path.read_text(encoding="utf-8") for path in modules("pipeline")}
    assert {name for name, text in texts.items() if words_in_strings(text) & stages} == NAMING_STAGES
    assert {"CageDecoder", "OccupancyDecoder"} <= networks
    assert not [name for name, text in texts.items() if words_in_strings(text) & networks]


def classes(text: str) -> set[str]:
    return {node.name for node in ast.parse(text).body if isinstance(node, ast.ClassDef)}


def words_in_strings(text: str) -> set[str]:
    """The words of all strings of a file but for its docstrings."""
    nodes = [*ast.walk(ast.parse(text))]
    docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    strings = [node.value for node in nodes if isinstance(node, ast.Constant) and id(node) not in docstrings]
    return {word for string in strings if isinstance(string, str) for word in re.split(r"\W+", string)}


def test_a_stage_or_network_that_is_named_in_a_string_is_seen() -> None:
    text = (
        '"""train"""\ndef f(arm: Literal["CageDecoder"]):\n    """fit_cuboids"""\n    return f"stages.evaluate {arm}"'
    )
    assert words_in_strings(text) & {"train", "CageDecoder", "fit_cuboids", "evaluate"} == {"CageDecoder", "evaluate"}


def test_an_import_by_a_call_is_seen() -> None:
    text = 'import_module(f"stages.{name}"); importlib.import_module("cagesdf.io"); __import__("stages")'
    assert imports(text, "") == {"stages.", "cagesdf.io", "stages"}
    with pytest.raises(AssertionError, match="doesn't tell"):
        imports("import_module(name)", "")


@pytest.mark.parametrize("path", modules("cagesdf") + modules("stages"), ids=lambda path: str(path.relative_to(ROOT)))
def test_what_stages_depend_on_is_imported_by_statements(path: Path) -> None:
    """`pipeline.library`, which decides on reruns, sees no others. Stages don't use the names of the Python API."""
    if path == ROOT / "cagesdf" / "__init__.py":
        return
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    assert not DYNAMIC & {called(node) for node in calls}


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
