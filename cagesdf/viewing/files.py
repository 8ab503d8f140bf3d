"""What comes into the editor and leaves it as files. Uploads are untrusted: bounded, read by the checked readers."""

import io
import lzma
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from cagesdf.editing.script import Script, parse
from cagesdf.editing.session import model_of
from cagesdf.editing.state import State
from cagesdf.errors import SHOWN, InputError
from cagesdf.extraction import Extraction
from cagesdf.formats.parts_folder import MESH_SUFFIXES
from cagesdf.io.exports import WRITERS, Model, write_boxes, write_model
from cagesdf.structure.parsing import parse as parse_program
from cagesdf.structure.program import AssemblyProgram
from cagesdf.text import decode

FORMATS = tuple(ending.removeprefix(".") for ending in WRITERS)
MAX_BYTES = 4_000_000  # of a script or program
MAX_MESH_BYTES = 40_000_000  # of meshes, unpacked
MAX_MESHES = 150  # in an archive
MAX_NAME = 200  # bytes of a file's name
# What zipfile raises for content that is damaged, encrypted, or packed in a way that it doesn't know; ValueError for
# names and places that can't be.
DAMAGED = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, NotImplementedError, RuntimeError, EOFError, OSError,
    ValueError, OverflowError,
)  # fmt: skip


def exported(found: Extraction, state: State, ending: str) -> bytes:
    """A state's surface as a file of one of FORMATS: what `cagesdf edit` writes.

    Raises InputError if there is no surface, and as `write_model`.
    """
    return _content(write_model, found, state, ending)


def exported_boxes(found: Extraction, state: State, ending: str) -> bytes:
    """A state's cuboids as a file of one of FORMATS: what `cagesdf edit --cuboids` writes. Raises as `exported`."""
    return _content(write_boxes, found, state, ending)


def _content(write: Callable[[Path, Model], None], found: Extraction, state: State, ending: str) -> bytes:
    if not len(found.mesh.faces):
        raise InputError("the network gives no surface for these cuboids in this style; nothing to export")
    model = model_of(found, state)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"shape.{ending}"
        write(path, model)
        return path.read_bytes()


@contextmanager
def script_called(name: str) -> Iterator[None]:
    """A context whose errors about a script name it as the user does."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace("script:", f"{name}:", 1)) from error


def script_of(name: str, content: bytes) -> Script:
    """The operations of an uploaded script. Raises InputError."""
    return parse(_text(name, content))


def program_of(name: str, content: bytes) -> AssemblyProgram:
    """An uploaded ShapeAssembly program: text, read and never run as code. Raises InputError."""
    return parse_program(_text(name, content), name)


def meshes_of(name: str, content: bytes, folder: Path) -> Path:
    """Uploaded meshes, put into an empty folder: a mesh file, or the folder with the part meshes that a zip holds.

    Folders within a zip are left out, and whatever isn't a mesh. Raises InputError for anything too large or doubtful.
    """
    if len(content) > MAX_MESH_BYTES:
        raise InputError(f"{name}: {len(content):,} bytes; wanted at most {MAX_MESH_BYTES:,}")
    suffix = PurePosixPath(name).suffix.lower()
    if suffix == ".zip":
        for own, mesh in _unpacked(name, content).items():
            (folder / own).write_bytes(mesh)
        return folder
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"{name}: wanted a {', '.join(MESH_SUFFIXES)} file, or a .zip with one for each part")
    # Under the user's name, which messages give.
    plain = PurePosixPath(name.replace("\\", "/")).name
    if len(plain.encode("utf-8")) > MAX_NAME or not plain.isprintable():
        plain = f"shape{suffix}"
    (folder / plain).write_bytes(content)
    return folder / plain


def _unpacked(name: str, content: bytes) -> dict[str, bytes]:
    """The meshes of a zip by their own names, without folders."""
    found: dict[str, bytes] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for member in archive.infolist():
                own = PurePosixPath(member.filename.replace("\\", "/")).name
                # A member may have no name at all, of which zipfile can't say whether it is a folder.
                if own.startswith(".") or PurePosixPath(own).suffix.lower() not in MESH_SUFFIXES or member.is_dir():
                    continue
                if own in found:
                    raise InputError(f"{name}: two meshes are called {own}; give each part a name of its own")
                if len(own.encode("utf-8")) > MAX_NAME or not own.isprintable():
                    raise InputError(f"{name}: a mesh is called {own[:SHOWN]!r}; wanted at most {MAX_NAME} letters")
                left = MAX_MESH_BYTES - sum(map(len, found.values()))
                with archive.open(member) as stream:
                    found[own] = stream.read(left + 1)
                if len(found[own]) > left or len(found) > MAX_MESHES:
                    most = f"at most {MAX_MESHES} meshes of {MAX_MESH_BYTES:,} bytes together"
                    raise InputError(f"{name}: holds too much; wanted {most}")
    except InputError:
        raise
    except DAMAGED as error:
        raise InputError(f"{name}: can't be read as a zip ({error})") from error
    if not found:
        raise InputError(f"{name}: holds no mesh; wanted a {', '.join(MESH_SUFFIXES)} file for each part")
    return found


def _text(name: str, content: bytes) -> str:
    if len(content) > MAX_BYTES:
        raise InputError(f"{name}: {len(content):,} bytes; wanted at most {MAX_BYTES:,}")
    return decode(content, name)
