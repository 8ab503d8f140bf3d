"""Runs for the commands."""

from pathlib import Path

import pytest

from tests.support.constant_runs import write_trained


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """A run of two boxes, whose cage is the surface."""
    return write_trained(tmp_path / "runs" / "cagesdf", -0.05)
