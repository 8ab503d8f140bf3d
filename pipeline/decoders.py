"""The decoders that arms may name, and the sizes that each is made with: read off cagesdf/models.

Importing them would take torch, and every stage checks all parameters as it starts.
"""

import ast
from functools import cache
from pathlib import Path

MODELS = Path(__file__).parent.parent / "cagesdf" / "models"
UNTYPED = "an argument without a type"
Class = ast.ClassDef


@cache
def decoder_sizes() -> dict[str, dict[str, str]]:
    """The arguments of each class that DECODERS of cagesdf/models/arms.py lists, with their types as they are written.

    By the class's name.
    """
    registry = next(
        node.value
        for node in _parsed(MODELS / "arms.py").body
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "DECODERS" and node.value
    )
    names = [ast.unparse(item) for node in ast.walk(registry) if isinstance(node, ast.Tuple) for item in node.elts]
    classes = {
        node.name: node for path in MODELS.glob("*.py") for node in _parsed(path).body if isinstance(node, Class)
    }
    return {name: _arguments(name, classes) for name in names}


def _arguments(name: str, classes: dict[str, Class]) -> dict[str, str]:
    """Arguments and types of a class's own `__init__`, or of its first base's."""
    for node in classes[name].body:
        if isinstance(node, ast.FunctionDef) and node.name == "__init__":
            arguments = node.args.args[1:]
            return {each.arg: ast.unparse(each.annotation) if each.annotation else UNTYPED for each in arguments}
    return _arguments(ast.unparse(classes[name].bases[0]), classes)


def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))
