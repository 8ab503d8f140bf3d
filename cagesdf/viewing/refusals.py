"""Exceptions in the editor: shown in one line, and logged with their traceback where they are defects."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cagesdf.editing.script import refusing
from cagesdf.errors import InputError, NotSolidError, ShapeRejected

LOG = logging.getLogger(__name__)


@contextmanager
def saying(say: Callable[[str], None]) -> Iterator[None]:
    """Say in one line what goes wrong inside.

    Input that is not as it must be, and shapes that can't be used, speak for themselves. Anything else is a defect:
    it is called so, and its traceback is logged.
    """
    try:
        with refusing():
            yield
    except (InputError, ShapeRejected, NotSolidError) as error:
        text = str(error)
    except MemoryError:
        LOG.warning("out of memory", exc_info=True)
        text = "this takes more memory than there is; simplify the shape, or close other programs"
    except Exception as error:
        LOG.exception("a defect of the editor")
        text = f"a defect of cagesdf, please report it: {type(error).__name__}: {error} (its traceback is in the log)"
    else:
        return
    say(" ".join(text.split()))
