"""Commands about ShapeAssembly programs."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cagesdf.cli.telling import Count
from cagesdf.errors import InputError, ProgramError
from cagesdf.io.files import check_folder, replacing

if TYPE_CHECKING:
    from cagesdf.structure.program import AssemblyProgram


def execute_programs(*paths: Path, out: Path | None = None, mesh: Path | None = None) -> None:
    """Say which cuboids ShapeAssembly programs make: a JSON object a program, on a line of its own.

    {"id": file name without .txt, "cuboids": [[centre 3, x axis 3, y axis 3, z axis 3, full lengths 3], ...]},
    or {"id": ..., "error": ...}; then the exit status is 1.

    Parameters
    ----------
    paths
        Program files, and folders with any number of them, at any depth; lists of ids such as train.txt are left out.
    out
        A .jsonl file for the lines, instead of standard output.
    mesh
        An .obj file for a single program's cuboids, each an object of its own.
    """
    from cagesdf.editing.parts import distinct_labels
    from cagesdf.formats.shapeassembly import list_programs
    from cagesdf.geometry.solid import CUBE_FACES
    from cagesdf.io.exports import obj
    from cagesdf.structure.executor import execute
    from cagesdf.structure.parsing import read_program

    files = list_programs(_given(paths))
    if mesh is not None and (len(files) != 1 or mesh.suffix.lower() != ".obj"):
        raise InputError(f"{mesh}: wanted one program and a name that ends in .obj; got {len(files):,} programs")
    for target in (out, mesh):
        if target is not None:
            check_folder(target)

    if mesh is not None:
        cage = execute(read_program(files[0]))
        names = distinct_labels({f"{files[0].stem}/{part}": "" for part in cage.part_ids})
        content = obj([(corners, {name: CUBE_FACES}) for name, corners in zip(names.values(), cage.corners())])
        with replacing(mesh) as partial:
            partial.write_text(content, encoding="utf-8", newline="\n")

    failures: list[ProgramError] = []
    lines = _answers(files, lambda program: {"cuboids": execute(program).vectors().tolist()}, failures)
    if out is None:
        for line in lines:
            print(line, flush=True)
    else:
        with replacing(out) as partial, partial.open("w", encoding="utf-8") as stream:
            stream.writelines(f"{line}\n" for line in lines)
        print(f"{out}: cuboids of {len(files) - len(failures):,} of {len(files):,} programs")
    _complain(failures, len(files))


def signature(*paths: Path, kind: Literal["exact", "canonical"] = "canonical", summary: bool = False) -> None:
    """Say which ShapeAssembly programs are equal up to continuous parameters: their signatures are.

    {"id": file name without .txt, "signature": text} on a line of its own, or {"id": ..., "error": ...}; then the
    exit status is 1.

    Parameters
    ----------
    paths
        Program files, and folders with any number of them, at any depth; lists of ids such as train.txt are left out.
    kind
        exact: equal programs have the same text but for the numbers; canonical: also the names of cuboids and the
        order of statements may differ.
    summary
        Count the classes of equal programs instead.
    """
    from cagesdf.formats.shapeassembly import list_programs
    from cagesdf.structure.canonical import canonical_signature, exact_signature

    sign = {"exact": exact_signature, "canonical": canonical_signature}[kind]
    files = list_programs(_given(paths))
    failures: list[ProgramError] = []
    classes: Counter[str] = Counter()

    def answer(program: "AssemblyProgram") -> dict[str, Any]:
        text = sign(program)
        classes[text] += 1
        return {"signature": text}

    for line in _answers(files, answer, failures):
        if not summary:
            print(line, flush=True)
    if summary:
        print("\n".join(_class_counts(classes)))
    _complain(failures, len(files))


def _given(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    if not paths:
        raise InputError("wanted files or folders with ShapeAssembly programs. See cagesdf --help.")
    return paths


def _answers(
    files: Sequence[Path], answer: Callable[["AssemblyProgram"], dict[str, Any]], failures: list[ProgramError]
) -> Iterator[str]:
    """A line of JSON for each program: its id, and the answer or the error, which is appended to `failures`."""
    from cagesdf.structure.parsing import read_program

    done = Count("programs", len(files))
    for file in files:
        try:
            result = answer(read_program(file))
        except ProgramError as error:
            failures.append(error)
            result = {"error": str(error)}
        done()
        yield json.dumps({"id": file.stem, **result}, ensure_ascii=False)


def _complain(failures: list[ProgramError], programs: int) -> None:
    if failures:
        raise InputError(f"{len(failures):,} of {programs:,} programs failed; the first: {failures[0]}")


def _class_counts(classes: Counter[str]) -> list[str]:
    from cagesdf.io.summary import aligned

    programs = classes.total()
    partnered = sum(count for count in classes.values() if count > 1)
    return aligned(
        [
            ["programs", f"{programs:,}"],
            ["classes", f"{len(classes):,}"],
            ["largest class", f"{max(classes.values(), default=0):,}"],
            ["with a partner", f"{partnered:,}" + (f" ({partnered / programs:.1%})" if programs else "")],
        ]
    )
