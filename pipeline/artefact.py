"""Artefacts: folders that a stage writes whole or not at all, with a manifest.

`manifest.json` holds the kind, the format, the parameters, the digest of each input's
manifest, and digests of the files. No times, hosts or absolute paths: the same inputs and
parameters give the same bytes, so that DVC can stop early.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.errors import PipelineError
from pipeline.params import Params

MANIFEST = "manifest.json"


class ArtefactError(PipelineError):
    """An artefact that is missing, incomplete, of another kind or of another format."""


@contextmanager
def write(
    kind: str, out: Path, inputs: Mapping[str, Path], params: Params, foreign: Mapping[str, Path] | None = None
) -> Iterator[Path]:
    """Yield a new folder to fill; publish it as `out` when the block ends without an exception.

    `inputs` maps the kind that is wanted to the artefact's folder; each is checked first, which
    raises ArtefactError. `foreign` are folders or files without a manifest (a user's own). The
    folder is `out.partial` until it is renamed, and an exception removes it, so that nothing
    half-written is ever in `out`'s place.
    """
    digests = {wanted: digest_file(_checked(path, wanted, params.format) / MANIFEST) for wanted, path in inputs.items()}
    digests |= {name: digest_tree(path) for name, path in (foreign or {}).items()}
    partial, old = out.with_name(out.name + ".partial"), out.with_name(out.name + ".old")
    for left in (partial, old):  # by a process that was killed
        shutil.rmtree(left, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
        manifest = {
            "kind": kind,
            "format": params.format,
            "params": params.model_dump(mode="json", exclude={"format"}),
            "inputs": digests,
            "files": {
                path.relative_to(partial).as_posix(): {"bytes": path.stat().st_size, "sha256": digest_file(path)}
                for path in sorted(partial.rglob("*"))
                if path.is_file()
            },
        }
        text = json.dumps(manifest, indent=1, sort_keys=True)
        (partial / MANIFEST).write_text(text + "\n", encoding="utf-8", newline="\n")
        if out.exists():
            os.replace(out, old)
            os.replace(partial, out)
            shutil.rmtree(old)
        else:
            os.replace(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of an artefact. Raises ArtefactError if it is missing or damaged."""
    if not path.is_dir():
        raise ArtefactError(f"{path}: no such folder; run the stage that writes it (dvc repro)")
    try:
        manifest = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ArtefactError(f"{path}: has no {MANIFEST}, so no stage finished it; run dvc repro") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ArtefactError(f"{path}/{MANIFEST}: is damaged ({error}); rerun the stage that writes it") from error
    if not isinstance(manifest, dict) or not {"kind", "format", "files"} <= manifest.keys():
        raise ArtefactError(f"{path}/{MANIFEST}: lacks kind, format or files; rerun the stage that writes it")
    return manifest


def inside(folder: Path, names: Iterable[str], kind: str, version: int) -> dict[str, Path]:
    """The artefacts of these names in a folder, sorted; what else lies there, of other runs, is left alone.

    Raises ArtefactError for one that is missing, of another kind or of another format.
    """
    return {name: _checked(folder / name, kind, version) for name in sorted(names)}


def _checked(path: Path, kind: str, version: int) -> Path:
    manifest = read_manifest(path)
    if manifest["kind"] != kind:
        raise ArtefactError(f"{path}: holds {manifest['kind']!r}, wanted {kind!r}; check the order of the paths")
    if manifest["format"] != version:
        raise ArtefactError(
            f"{path}: was written in format {manifest['format']}, params.yaml says {version}; rerun the stage"
        )
    for name, file in manifest["files"].items():
        if not (path / name).is_file():
            raise ArtefactError(f"{path}: lacks {name}; rerun the stage that writes it")
        if (path / name).stat().st_size != file["bytes"]:
            raise ArtefactError(f"{path / name}: is not as it was written, {file['bytes']:,} bytes; rerun the stage")
    return path


def digest_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_tree(path: Path) -> str:
    """One digest of all files below a folder, names included, also behind links; of a file's bytes if it is one."""
    if path.is_file():
        return digest_file(path)
    total = hashlib.sha256()
    for item in sorted(_files(path, frozenset())):
        total.update(os.fsencode(f"{item.relative_to(path).as_posix()}\0{digest_file(item)}\n"))
    return total.hexdigest()


def _files(folder: Path, above: frozenset[Path]) -> Iterator[Path]:
    """The files below a folder. A link to one of the folders `above` it, which would never end, is passed over."""
    real = folder.resolve()
    for item in folder.iterdir() if real not in above else ():
        if item.is_dir():
            yield from _files(item, above | {real})
        elif item.is_file():
            yield item
