"""What comes into the editor and leaves it as files. Uploads are untrusted: bounded, read by the checked readers."""

import io
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from cagesdf.editing.script import Script, parse
from cagesdf.editing.session import model_of
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.formats.parts_folder import MESH_SUFFIXES
from cagesdf.io.exports import WRITERS, write_model
from cagesdf.meshes import Mesh
from cagesdf.structure.parsing import parse as parse_program
from cagesdf.structure.program import AssemblyProgram

FORMATS = tuple(ending.removeprefix(".") for ending in WRITERS)
MAX_BYTES = 4_000_000  # of a script or program
MAX_MESH_BYTES = 40_000_000  # of meshes, unpacked
MAX_MESHES = 150  # in an archive


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
    (folder / f"shape{suffix}").write_bytes(content)
    return folder / f"shape{suffix}"


def _unpacked(name: str, content: bytes) -> dict[str, bytes]:
    """The meshes of a zip by their own names, without folders."""
    found: dict[str, bytes] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for member in archive.infolist():
                own = PurePosixPath(member.filename.replace("\\", "/")).name
                if member.is_dir() or own.startswith(".") or PurePosixPath(own).suffix.lower() not in MESH_SUFFIXES:
                    continue
                if own in found:
                    raise InputError(f"{name}: two meshes are called {own}; give each part a name of its own")
                left = MAX_MESH_BYTES - sum(map(len, found.values()))
                with archive.open(member) as stream:
                    found[own] = stream.read(left + 1)
                if len(found[own]) > left or len(found) > MAX_MESHES:
                    most = f"at most {MAX_MESHES} meshes of {MAX_MESH_BYTES:,} bytes together"
                    raise InputError(f"{name}: holds too much; wanted {most}")
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise InputError(f"{name}: can't be read as a zip ({error})") from error
    if not found:
        raise InputError(f"{name}: holds no mesh; wanted a {', '.join(MESH_SUFFIXES)} file for each part")
    return found


def _text(name: str, content: bytes) -> str:
    if len(content) > MAX_BYTES:
        raise InputError(f"{name}: {len(content):,} bytes; wanted at most {MAX_BYTES:,}")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: is no text in UTF-8 ({error})") from error
