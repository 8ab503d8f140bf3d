"""Sound files of each format, and what becomes of them when bytes, words and lines go astray.

A format that is added to `FORMATS` is fuzzed by `tests/formats/test_mutants.py` and `benchmarks/fuzz_readers.py`.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cagesdf.formats.gltf import read_gltf
from cagesdf.formats.obj import read_obj_groups
from cagesdf.formats.parts_folder import read_parts_file
from cagesdf.formats.ply import read_ply
from cagesdf.formats.stl import read_stl
from cagesdf.geometry.meshes import Mesh
from tests.support import toy
from tests.support.gltf_files import Gltf

BOX = toy.box([0, 0, 0], [1, 2, 3])
# Words that have broken readers: numbers at the ends of types, and what stands for no number.
WORDS = (
    b"0", b"-1", b"1", b"255", b"256", b"65536", b"2147483647", b"-2147483648", b"4294967296", b"9223372036854775807",
    b"99999999999999999999999999", b"nan", b"inf", b"-inf", b"1e308", b"1e-308", b"1e999", b"0x10", b"1_0", b"1,5",
    b"", b"#", b"\\", b"/", b"\xff", b"\0", b"\xef\xbb\xbf", "ü".encode(), b" " * 3000, b"9" * 5000,
)  # fmt: skip


@dataclass(frozen=True)
class Format:
    """Sound files and their reader, which may raise InputError or ShapeRejected and nothing else."""

    files: Callable[[], dict[str, bytes]]  # by name
    read: Callable[[Path], Any]


def quads() -> tuple[np.ndarray, list[list[int]]]:
    """An L of two concave hexagons and six quads."""
    outline = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
    points = np.array([[x, y, z] for z in (0, 0.2) for x, y in outline])
    sides = [[i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6)]
    return points, [[6, 7, 8, 9, 10, 11], [5, 4, 3, 2, 1, 0], *sides]


def obj_files() -> dict[str, bytes]:
    points, faces = quads()
    vertices = "".join(f"v {x:g} {y:g} {z:g} 1 0.5 0 # a corner\n" for x, y, z in points)
    loops = ["f " + " ".join(f"{i + 1}/{i + 1}//3" for i in face) for face in faces]
    continued = [loop.replace(" ", " \\\n", 1) for loop in loops[4:]]
    named = "\n".join([vertices, "o seat # red", "g a", *loops[:4], "o leg", "g b", *continued, ""])
    backwards = vertices + "\n".join("f " + " ".join(str(i - 12) for i in face) for face in faces)
    return {
        "named.obj": named.encode(),
        "backwards.obj": backwards.replace("\n", "\r\n").encode(),
        "utf16.obj": named.replace("seat", "Stühle").encode("utf-16"),
        "latin1.obj": named.replace("seat", "Stühle").replace("\n", "\r").encode("latin-1"),
    }


def ply_file(
    order: str, points: np.ndarray, faces: list[list[int]], length: str = "uchar", index: str = "int"
) -> bytes:
    """A PLY file in `order` ("ascii", "<" or ">") with colours, an element before the faces, and one behind them."""
    name = {"ascii": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = (
        f"ply\nformat {name} 1.0\ncomment made up\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nelement camera 1\nproperty list ushort double pose\n"
        f"element face {len(faces)}\nproperty char flags\nproperty list {length} {index} vertex_indices\n"
        "element edge 1\nproperty int a\nproperty int b\nend_header\n"
    ).encode()
    if order == "ascii":
        rows = [*(f"{x:g} {y:g} {z:g} 7" for x, y, z in points), "2 0.5 0.25"]
        rows += [f"3 {len(face)} {' '.join(map(str, face))}" for face in faces]
        return header + "\n".join([*rows, "0 1", ""]).encode()
    code = {"uchar": "B", "char": "b", "ushort": "H", "int": "i", "uint": "I", "short": "h"}
    body = b"".join(struct.pack(f"{order}3fB", *map(float, point), 7) for point in points)
    body += struct.pack(f"{order}H2d", 2, 0.5, 0.25)
    body += b"".join(struct.pack(f"{order}b{code[length]}{len(f)}{code[index]}", 3, len(f), *f) for f in faces)
    return header + body + struct.pack(f"{order}2i", 0, 1)


def ply_files() -> dict[str, bytes]:
    names = {"ascii": "text", "<": "little", ">": "big"}
    files = {f"{names[order]}.ply": ply_file(order, *quads()) for order in names}
    strip = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
    strip += b"element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    return {**files, "strip.ply": strip + b"9 0 1 2 3 -1 3 1 0 2\n"}


def stl_text(mesh: Mesh, name: str) -> str:
    facets = []
    for triangle in mesh.corners().tolist():
        corners = "".join(f"      vertex {x:e} {y:e} {z:e}\n" for x, y, z in triangle)
        facets.append(f"  facet normal 0 0 0\n    outer loop\n{corners}    endloop\n  endfacet\n")
    return f"solid {name}\n{''.join(facets)}endsolid {name}\n"


def stl_binary(mesh: Mesh, header: bytes) -> bytes:
    triangles = b"".join(
        struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0xFC00) for triangle in mesh.corners().astype(np.float32)
    )
    return header.ljust(80) + struct.pack("<I", len(mesh.faces)) + triangles


def stl_files() -> dict[str, bytes]:
    both = stl_text(BOX, "seat") + stl_text(toy.box([5, 0, 0], [1, 1, 1]), "Stühle")
    return {
        "text.stl": both.encode(),
        "latin1.stl": both.upper().replace("\n", "\r\n").encode("latin-1"),
        "binary.stl": stl_binary(BOX, b"CAD"),
        "solid.stl": stl_binary(BOX, b"solid CAD"),
    }


def glb_files() -> dict[str, bytes]:
    file = Gltf()
    file.show(file.part(BOX, "seat"), file.part(toy.ball([0, 0, 0], 1, 8), "Stühle", scale=[1, -2, 3]))
    return {"parts.glb": file.glb()}


FORMATS = {
    "glb": Format(glb_files, read_gltf),
    "obj": Format(obj_files, read_obj_groups),
    "ply": Format(ply_files, read_ply),
    "stl": Format(stl_files, read_stl),
    "shape": Format(lambda: {**obj_files(), **ply_files(), **stl_files()}, lambda p: read_parts_file(p, "a", "train")),
}


def mutant(content: bytes, rng: np.random.Generator) -> bytes:
    """A file with one or two mistakes."""
    for _ in range(rng.integers(1, 3)):
        content = MISTAKES[rng.integers(len(MISTAKES))](content, rng)
    return content


def _flipped(content: bytes, rng: np.random.Generator) -> bytes:
    """One bit of one byte."""
    if not content:
        return content
    at = int(rng.integers(len(content)))
    return content[:at] + bytes([content[at] ^ (1 << int(rng.integers(8)))]) + content[at + 1 :]


def _replaced(content: bytes, rng: np.random.Generator) -> bytes:
    """A few bytes by others."""
    at, length = int(rng.integers(len(content) + 1)), int(rng.integers(1, 9))
    return content[:at] + rng.bytes(length) + content[at + length :]


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def _without(content: bytes, rng: np.random.Generator) -> bytes:
    at, length = int(rng.integers(len(content) + 1)), int(rng.integers(1, 40))
    return content[:at] + content[at + length :]


def _repeated(content: bytes, rng: np.random.Generator) -> bytes:
    """A piece twice or many times."""
    at, length = int(rng.integers(len(content) + 1)), int(rng.integers(1, 200))
    return content[:at] + content[at : at + length] * int(rng.integers(2, 30)) + content[at + length :]


def _other_word(content: bytes, rng: np.random.Generator) -> bytes:
    """A word of the text, or of the header, by one that has broken readers."""
    words = content.split(b" ")
    words[int(rng.integers(len(words)))] = WORDS[int(rng.integers(len(WORDS)))]
    return b" ".join(words)


def _swapped(content: bytes, rng: np.random.Generator) -> bytes:
    """Two lines in each other's place."""
    lines = content.split(b"\n")
    i, j = (int(i) for i in rng.integers(len(lines), size=2))
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


MISTAKES = (_flipped, _replaced, _cut, _without, _repeated, _other_word, _swapped)
