"""The shapes of one visitor: the document that is open, what is selected of it, and what is done to it."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
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

LEAPS = 50  # that are remembered


@dataclass(frozen=True, eq=False)
class Leap:
    """A change of a document that is no single operation, but one step for the user."""

    before: Document
    after: Document


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
        self._leaps: list[Leap] = []
        self._leaps_back: list[Leap] = []

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

    @property
    def held_back(self) -> bool:
        """Whether a part that is selected is locked."""
        return bool(self.selection.locked & {*self.selection.parts})

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
        after = self._sliding.changed(self.document, control, operations, self.styles)
        before = self._sliding.before
        if len(after.done) > len(before.done) + 1:
            self._remember(Leap(before, after))
        self._put(after)

    def add(self, *operations: Operation) -> None:
        """Do operations as one step, and select the parts that they add. Raises InputError as `Document.then`."""
        before = self.state.cage.part_ids
        self.slide((), lambda _: operations)
        self.selection = self.selection.of([part for part in self.state.cage.part_ids if part not in before])

    def one_more(self, hand: Hand) -> None:
        """One more part in the row of the held one. Raises InputError as `Hand.one_more`, and for locked parts."""
        if locked := self.selection.locked & {*hand.row()}:
            names = ", ".join(self.selection.of(sorted(locked)).names(self.state.structure))
            raise InputError(f"{names}: locked, and would have to make room")
        self.add(*hand.one_more())

    def become(self, document: Document) -> None:
        """Replace the document by what an operation or its undoing made of it."""
        self._sliding.end()
        self._put(document)

    def replace(self, document: Document) -> None:
        """Replace the document by another one of its name, as one step."""
        self._remember(Leap(self.document, document))
        self.become(document)

    def open(self, document: Document) -> None:
        """Open a document of the shelf; nothing of it is selected."""
        self.selection = Selection()
        self.become(document)

    def undo(self) -> None:
        """Take the last step back. Raises InputError where there is none."""
        leap = next((leap for leap in reversed(self._leaps) if self._is_at(leap.after)), None)
        if leap is None:
            self.become(self.shelf.undone(self.document.name, self.styles))
            return
        self._leaps.remove(leap)
        self._leaps_back.append(leap)
        self.become(leap.before)

    def redo(self) -> None:
        """Do again what was taken back. Raises InputError where there is none."""
        leap = next((leap for leap in reversed(self._leaps_back) if leap.before is self.document), None)
        if leap is None:
            self.become(self.document.redone(self.styles))
            return
        self._leaps_back.remove(leap)
        self._remember(leap)
        self.become(leap.after)

    def reset(self) -> None:
        """The document as it was at first. One undo leads back; the drafts keep what was done until something is."""
        first = self.shelf.reset(self.document.name)
        if self.document.script != first.script:
            self._remember(Leap(self.document, first))
        self._sliding.end()
        self.document = first
        self.selection = self.selection.within(first.state.cage.part_ids)

    def _remember(self, leap: Leap) -> None:
        self._leaps = [*self._leaps[-LEAPS:], leap]

    def _is_at(self, document: Document) -> bool:
        """Whether what is done now is what was done there."""
        return self.document.name == document.name and self.document.done == document.done

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
