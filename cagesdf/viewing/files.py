"""Uploads and downloads of the editor. Uploads are untrusted: bounded, and read by the checked readers."""

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
from cagesdf.editing.session import export_of
from cagesdf.editing.state import State
from cagesdf.errors import SHOWN, InputError
from cagesdf.exported import ExportedShape
from cagesdf.extraction import Extraction
from cagesdf.formats.parts_folder import MESH_SUFFIXES
from cagesdf.io.exports import WRITERS, write_boxes, write_export
from cagesdf.structure.parsing import parse as parse_program
from cagesdf.structure.program import AssemblyProgram
from cagesdf.text import decode

FORMATS = tuple(ending.removeprefix(".") for ending in WRITERS)
MAX_BYTES = 4_000_000  # per script or program
MAX_MESH_BYTES = 40_000_000  # all meshes of an upload, unpacked
MAX_MESHES = 150  # in an archive
MAX_NAME = 200  # bytes per file name
# Raised by zipfile for content that is damaged, encrypted or packed by an unknown method; ValueError for impossible
# names and offsets.
DAMAGED = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, NotImplementedError, RuntimeError, EOFError, OSError,
    ValueError, OverflowError,
)  # fmt: skip


def exported(surface: Extraction, state: State, ending: str) -> bytes:
    """A state's surface as a file of one of FORMATS: what `cagesdf edit` writes.

    Raises InputError if there is no surface, and as `write_export`.
    """
    return _content(write_export, surface, state, ending)


def exported_boxes(surface: Extraction, state: State, ending: str) -> bytes:
    """A state's cuboids as a file of one of FORMATS: what `cagesdf edit --cuboids` writes. Raises as `exported`."""
    return _content(write_boxes, surface, state, ending)


def _content(write: Callable[[Path, ExportedShape], None], surface: Extraction, state: State, ending: str) -> bytes:
    if not len(surface.mesh.faces):
        raise InputError("the network gives no surface for these cuboids in this style; nothing to export")
    shape = export_of(surface, state)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"shape.{ending}"
        write(path, shape)
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
        for member, mesh in _unpacked(name, content).items():
            (folder / member).write_bytes(mesh)
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
    meshes: dict[str, bytes] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for member in archive.infolist():
                name_inside = PurePosixPath(member.filename.replace("\\", "/")).name
                # A member may have no name at all, of which zipfile can't say whether it is a folder.
                if (
                    name_inside.startswith(".")
                    or PurePosixPath(name_inside).suffix.lower() not in MESH_SUFFIXES
                    or member.is_dir()
                ):
                    continue
                if name_inside in meshes:
                    raise InputError(f"{name}: two meshes are called {name_inside}; give each part a name of its own")
                if len(name_inside.encode("utf-8")) > MAX_NAME or not name_inside.isprintable():
                    raise InputError(
                        f"{name}: a mesh is called {name_inside[:SHOWN]!r}; wanted at most {MAX_NAME} letters"
                    )
                left = MAX_MESH_BYTES - sum(map(len, meshes.values()))
                with archive.open(member) as stream:
                    meshes[name_inside] = stream.read(left + 1)
                if len(meshes[name_inside]) > left or len(meshes) > MAX_MESHES:
                    most = f"at most {MAX_MESHES} meshes of {MAX_MESH_BYTES:,} bytes together"
                    raise InputError(f"{name}: holds too much; wanted {most}")
    except InputError:
        raise
    except DAMAGED as error:
        raise InputError(f"{name}: can't be read as a zip ({error})") from error
    if not meshes:
        raise InputError(f"{name}: holds no mesh; wanted a {', '.join(MESH_SUFFIXES)} file for each part")
    return meshes


def _text(name: str, content: bytes) -> str:
    if len(content) > MAX_BYTES:
        raise InputError(f"{name}: {len(content):,} bytes; wanted at most {MAX_BYTES:,}")
    return decode(content, name)
