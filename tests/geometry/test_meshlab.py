"""The process of pymeshlab: what it answers, and that nothing which happens to it reaches us."""

from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError, NotSolidError
from cagesdf.geometry.meshes import Mesh, is_closed
from cagesdf.geometry.meshlab import alpha_wrap, self_union
from tests.support import toy

BOX = toy.box([0, 0, 0], [1, 1, 1])
MISSING = "raise ImportError('libGL.so.1: cannot open shared object file')"
WITHOUT = "class MeshSet:\n    def __init__(self, verbose): pass"


def fake(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Another pymeshlab, for the process alone."""
    (folder / "pymeshlab.py").write_text(text)
    monkeypatch.syspath_prepend(folder)


def test_a_wrap_is_closed_and_as_far_away_as_asked() -> None:
    vertices, faces = alpha_wrap(BOX.vertices, BOX.faces[2:], 0.2, 0.05, 60)
    assert is_closed(Mesh(vertices, faces.astype(np.int32)))
    np.testing.assert_allclose(vertices.max(0), 0.55, atol=0.01)


def test_the_union_of_a_mesh_with_itself_is_the_mesh() -> None:
    vertices, faces = self_union(BOX.vertices, BOX.faces, 60)
    assert is_closed(Mesh(vertices, faces.astype(np.int32)))
    np.testing.assert_allclose(sorted(vertices.tolist()), sorted(BOX.vertices.tolist()))


@pytest.mark.parametrize("text", [MISSING, WITHOUT], ids=["missing", "without its plugins"])
def test_missing_system_libraries_are_an_input_error_with_the_line_that_installs_them(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(tmp_path, monkeypatch, text)
    with pytest.raises(InputError, match="apt-get install libgl1 libopengl0 libegl1"):
        alpha_wrap(BOX.vertices, BOX.faces, 0.2, 0.05, 60)


@pytest.mark.parametrize(
    ("text", "seconds", "reason"),
    [
        ("while True: pass", 1, "ended after 1 s"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", 60, "SIGSEGV"),
        ("raise ValueError('too bad a mesh')", 60, "too bad a mesh"),
    ],
    ids=["hangs", "crashes", "fails"],
)
def test_a_process_that_hangs_crashes_or_fails_is_a_part_that_can_not_be_used(
    text: str, seconds: int, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(tmp_path, monkeypatch, text)
    with pytest.raises(NotSolidError, match=reason):
        alpha_wrap(BOX.vertices, BOX.faces, 0.2, 0.05, seconds)
