"""Readers meet files with mistakes: they read them or say what is wrong, by one exception."""

import contextlib
from pathlib import Path

import numpy as np
import pytest

from cagesdf.errors import InputError, ShapeRejected
from tests.support import mutants

COUNT = 150  # of each format; benchmarks/fuzz_readers.py does thousands


@pytest.mark.parametrize("name", sorted(mutants.FORMATS))
def test_sound_files_are_read(tmp_path: Path, name: str) -> None:
    for file, content in mutants.FORMATS[name].files().items():
        (tmp_path / file).write_bytes(content)
        assert mutants.FORMATS[name].read(tmp_path / file), file


@pytest.mark.parametrize("name", sorted(mutants.FORMATS))
def test_a_file_with_mistakes_is_read_or_refused_and_nothing_else_happens(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(0)
    files = sorted(mutants.FORMATS[name].files().items())
    for i in range(COUNT):
        file, content = files[i % len(files)]
        (tmp_path / file).write_bytes(mutants.mutant(content, rng))
        with contextlib.suppress(InputError, ShapeRejected):
            mutants.FORMATS[name].read(tmp_path / file)
