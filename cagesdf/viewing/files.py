"""What comes into the editor and leaves it as files. Uploads are untrusted: bounded, read by the checked readers."""

import tempfile
from pathlib import Path

from cagesdf.editing.script import Script, parse
from cagesdf.editing.session import model_of
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.io.exports import WRITERS, write_model
from cagesdf.meshes import Mesh
from cagesdf.structure.parsing import parse as parse_program
from cagesdf.structure.program import AssemblyProgram

FORMATS = tuple(ending.removeprefix(".") for ending in WRITERS)
MAX_BYTES = 4_000_000  # of an upload


def exported(mesh: Mesh, state: State, ending: str) -> bytes:
    """A state's surface as a file of one of FORMATS: what `cagesdf edit` writes. InputError if there is no surface."""
    if not len(mesh.faces):
        raise InputError("the network gives no surface for these cuboids in this style; nothing to export")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"shape.{ending}"
        write_model(path, model_of(mesh, state))
        return path.read_bytes()


def script_of(name: str, content: bytes) -> Script:
    """The operations of an uploaded script. Raises InputError."""
    return parse(_text(name, content))


def program_of(name: str, content: bytes) -> AssemblyProgram:
    """An uploaded ShapeAssembly program: text, read and never run as code. Raises InputError."""
    return parse_program(_text(name, content))


def _text(name: str, content: bytes) -> str:
    if len(content) > MAX_BYTES:
        raise InputError(f"{name}: {len(content):,} bytes; wanted at most {MAX_BYTES:,}")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: is no text in UTF-8 ({error})") from error
