"""One thread a process, since pytest-xdist runs one a core; hypothesis without clocks, the same examples every time.

The files that take longest come first, so that no worker ends long after the others; names of tests are words.
"""

import inspect
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ForwardRef

import jaxtyping
import pytest
from beartype import BeartypeConf, beartype
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from cagesdf.editing.session import Session
    from tests.support.commands import Command

for name in ("OMP_NUM_THREADS", "IGL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

jaxtyped = jaxtyping.jaxtyped


def checked(*, typechecker: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """jaxtyping's decorator for what has arrays in its signature, beartype alone for other functions.

    A function without arrays has no dimensions that must agree, and jaxtyping takes 30 µs of each of its calls. It also
    leaves names alone that are imported for type checkers only, which beartype refuses.
    """

    def decorated(item: Any) -> Any:
        if inspect.isclass(item) or any(word in str(_hints(item)) for word in ("jaxtyping.", "ForwardRef")):
            return jaxtyped(item, typechecker=typechecker)
        return beartype(conf=BeartypeConf(violation_type=TypeError))(item)

    return decorated


def _hints(function: Any) -> list[Any]:
    hints = function.__annotations__.values()
    return [ForwardRef(hint) if isinstance(hint, str) else hint for hint in hints]


setattr(jaxtyping, "jaxtyped", checked)  # noqa: B010 — by this name the import hook finds it

# A busy machine is no failure, and a run must not fail by chance: new examples come with a change of the test.
settings.register_profile("project", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("project")

# By processor seconds on AVX2, from 300 down to 25; those that aren't named take less.
LONGEST = (
    "project/test_end_to_end", "browser/test_editor", "pipeline/test_planning", "synthesis/test_dataset",
    "geometry/test_broken", "browser/test_working", "geometry/test_solid", "project/test_collection",
    "browser/test_found_parts", "pipeline/test_cluster", "pipeline/test_faults", "pipeline/test_lanes",
    "report/test_page",
)  # fmt: skip
LONG_NAME = 60  # characters


@pytest.fixture(scope="module")
def session() -> "Session":
    """Two chairs, a and b, in one cage, and a network that was never trained."""
    from tests.support.untrained import untrained

    return untrained()


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> "Command":
    """The `cagesdf` command, in this process."""
    from tests.support.commands import Command

    return Command(capsys, monkeypatch)


@pytest.fixture
def run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run whose network is Balls, and a quick `fit`."""
    from tests.support import balls

    return balls.write_run(tmp_path / "run", monkeypatch)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole files, since what a file's tests share is made once."""
    place = {name: number for number, name in enumerate(LONGEST)}
    here = Path(__file__).parent
    items.sort(key=lambda item: place.get(item.path.relative_to(here).with_suffix("").as_posix(), len(place)))


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Bytes, and text that is no word or line of words, are called like their argument, with a number."""
    if isinstance(val, bytes) or (isinstance(val, str) and not is_name(val)):
        return argname
    return None


def is_name(text: str) -> bool:
    """Whether a test may be called so."""
    return text.isascii() and text.isprintable() and "\\" not in text and len(text) <= LONG_NAME
