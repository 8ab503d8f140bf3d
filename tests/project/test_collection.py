"""The tests themselves: workers of pytest-xdist, and who looks a failure up, collect the same ones in one order."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
COLLECT = [
    "-m",
    "pytest",
    "-o",
    "addopts=--import-mode=importlib",
    "-p",
    "no:cacheprovider",
    "--collect-only",
    "--quiet",
]
# A path, then words, numbers and signs; no escapes (of bytes and lines), no addresses, no places of a machine.
NAME = re.compile(r"tests/[\w/]+\.py::\w+(\[[^\\]*\])?")
OF_A_MOMENT = re.compile(r"0x[0-9a-f]{6,}|<[\w.]+ object|/tmp/|" + re.escape(str(ROOT)))


def collect(seed: int) -> subprocess.Popen[str]:
    """A process that prints the names of all tests."""
    environment = os.environ | {"PYTHONHASHSEED": str(seed)}
    return subprocess.Popen([sys.executable, *COLLECT], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)


def test_names_and_order_of_tests_depend_on_neither_hash_seed_nor_time_and_names_are_words() -> None:
    first = collect(1)
    time.sleep(2.1)  # a zip holds even seconds
    second = collect(2)
    names, again = ([line for line in done.communicate()[0].splitlines() if "::" in line] for done in (first, second))
    assert len(names) > 1000
    assert names == again
    assert len(set(names)) == len(names)
    assert [name for name in names if not NAME.fullmatch(name) or OF_A_MOMENT.search(name)] == []
