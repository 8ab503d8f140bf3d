"""Controls that go on being changed: a slider that is dragged, a number that is typed further."""

from collections.abc import Callable, Iterable

from cagesdf.editing.document import Document
from cagesdf.editing.script import Operation
from cagesdf.editing.state import State
from cagesdf.editing.styles import Styles

Control = tuple[object, ...]  # what is changed, and of which parts; () is none


class Sliding:
    """The control that was changed last, and the document without what it did."""

    def __init__(self) -> None:
        self._control: Control = ()
        self._before: Document | None = None

    @property
    def before(self) -> Document:
        """The document without what the control did that was changed last."""
        assert self._before is not None, "no control was changed"
        return self._before

    def changed(
        self,
        document: Document,
        control: Control,
        operations: Callable[[State], Iterable[Operation]],
        styles: Styles,
    ) -> Document:
        """The document after what a control says of a state: the one that it had before the control began to change.

        Operations of the same control replace those that it did before. Raises InputError as `Document.then`; all is as
        it was then.
        """
        same = bool(control) and control == self._control
        before = self._before if same and self._before is not None else document
        after = before
        for operation in operations(before.state):
            after = after.then(operation, styles)
        self._control, self._before = control, before
        return after

    def end(self) -> None:
        """Something else was done."""
        self._control, self._before = (), None
