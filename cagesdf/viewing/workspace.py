"""The shapes of one visitor: the document that is open, what is selected of it, and what is done to it."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from cagesdf.cuboid import Cuboid
from cagesdf.editing.document import Document
from cagesdf.editing.script import Operation
from cagesdf.editing.state import State
from cagesdf.editing.styles import Styles
from cagesdf.errors import InputError
from cagesdf.parts.changing import Dissection
from cagesdf.viewing.hand import Hand
from cagesdf.viewing.selection import Selection
from cagesdf.viewing.shelf import Shelf
from cagesdf.viewing.sliding import Control, Sliding
from cagesdf.viewing.uploads import Upload


class Workspace:
    """The document that is open, one of a shelf's, with the selection. Knows nothing of browsers.

    Methods that raise InputError leave all as it was.
    """

    def __init__(self, shelf: Shelf, styles: Styles, first: str) -> None:
        """`first` is the name of the document that is open at first."""
        self.shelf, self.styles = shelf, styles
        self.document = shelf.take(first)
        self.selection = Selection()
        self._sliding = Sliding()

    @property
    def state(self) -> State:
        """The state that the open document leads to."""
        return self.document.state

    # What is selected

    def one(self, state: State) -> Cuboid | None:
        """The cuboid that is selected in a state, if it is only one."""
        parts = self.selection.parts
        return state.cage[parts[0]] if len(parts) == 1 else None

    @property
    def names(self) -> str:
        """Names of the parts that are selected."""
        return ", ".join(self.selection.names(self.state.structure))

    @property
    def pattern(self) -> str:
        """The selection, for an operation. Raises InputError as `Selection.pattern`."""
        return self.selection.pattern(self.state.structure)

    def hand(self, state: State, followers: Mapping[str, Any]) -> Hand:
        """The selection in a state, for operations. Raises InputError as `Selection.pattern`."""
        return Hand(state, self.selection.parts, self.pattern, followers)

    # What is done

    def tried(self, operation: Operation) -> State:
        """The state after an operation that isn't done yet. Raises InputError as `Document.then`."""
        self.check_fitted()
        return self.document.then(operation, self.styles).state

    def do(self, operation: Operation, control: Control = ()) -> None:
        """Do an operation; one of the same control replaces the one before. Raises InputError as `Document.then`."""
        self.slide(control, lambda _: [operation])

    def slide(self, control: Control, operations: Callable[[State], Iterable[Operation]]) -> None:
        """Do what a control says of the state before it began to change. Raises InputError as `Document.then`."""
        self.check_fitted()
        self._put(self._sliding.changed(self.document, control, operations, self.styles))

    def add(self, operation: Operation) -> None:
        """Do an operation, and select the parts that it adds. Raises InputError as `Document.then`."""
        before = self.state.cage.part_ids
        self.do(operation)
        self.selection = self.selection.of([part for part in self.state.cage.part_ids if part not in before])

    def become(self, document: Document) -> None:
        """Replace the document by another one of its name, to which no control led."""
        self._sliding.end()
        self._put(document)

    def open(self, document: Document) -> None:
        """Open a document of the shelf; nothing of it is selected."""
        self.selection = Selection()
        self.become(document)

    def undo(self) -> None:
        """Take the last operation back. Raises InputError where there is none."""
        self.become(self.shelf.undone(self.document.name, self.styles))

    def redo(self) -> None:
        """Do again what was taken back. Raises InputError where there is none."""
        self.become(self.document.redone(self.styles))

    def reset(self) -> None:
        """The document as it was at first."""
        self.become(self.shelf.reset(self.document.name))

    def _put(self, document: Document) -> None:
        self.document = document
        self.selection = self.selection.within(document.state.cage.part_ids)
        self.shelf.put(document)

    # The mesh that the open shape comes from

    @property
    def upload(self) -> Upload | None:
        """The file that the open shape comes from."""
        return self.shelf.upload(self.document.name)

    @property
    def unfitted(self) -> Dissection | None:
        """The parts of the mesh as they were changed, if the network hasn't seen them yet."""
        return None if self.upload is None else self.upload.unfitted(self.document)

    def check_fitted(self) -> None:
        """Raises InputError where the network hasn't seen the parts."""
        if self.unfitted is not None:
            raise InputError("the parts of the mesh were changed: press Fit again (in Found parts) first, or undo")
