"""A shape that is being edited: the script that leads to it, which files keep."""

from dataclasses import dataclass, replace

from cagesdf.editing.operations import apply
from cagesdf.editing.script import MAX_OPERATIONS, Operation, Redo, Script, Step, Undo
from cagesdf.editing.state import History, State
from cagesdf.editing.styles import Styles
from cagesdf.errors import InputError


@dataclass(frozen=True, eq=False)
class Document:
    """A script and all that it leads to; `cagesdf edit` reads the script and comes to the same state."""

    shape_id: str  # the shape of the run that it starts from
    script: Script
    history: History
    before: "Document | None"  # without the last operation; None at the beginning
    name: str  # of the shape that it leads to, in lists and files; the user's

    @staticmethod
    def opened(shape_id: str, state: State) -> "Document":
        """A shape that nothing was done to."""
        return Document(shape_id, (), History.of(state), None, shape_id)

    @property
    def state(self) -> State:
        """Where the script leads."""
        return self.history.present

    @property
    def done(self) -> tuple[Step, ...]:
        """The operations that lead to the state, without those that were taken back."""
        done: list[Step] = []
        undone: list[Step] = []
        for operation in self.script:
            match operation:
                case Undo():
                    undone.append(done.pop())
                case Redo():
                    done.append(undone.pop())
                case _:
                    done.append(operation)
                    undone.clear()
        return tuple(done)

    def then(self, operation: Operation, styles: Styles) -> "Document":
        """One operation more. Raises InputError for one that can't be done, and for a script as long as may be."""
        if len(self.script) == MAX_OPERATIONS:
            raise InputError(f"the script has {MAX_OPERATIONS:,} operations, the most there may be; save it and reset")
        history = apply(self.history, operation, styles)
        return Document(self.shape_id, (*self.script, operation), history, self, self.name)

    def named(self, name: str) -> "Document":
        """The same under another name, which those that follow have, too."""
        return replace(self, name=name)

    def continued(self, script: Script, styles: Styles) -> "Document":
        """All operations of a script more. Raises InputError that names the place of one that can't be done."""
        document = self
        for i, operation in enumerate(script):
            try:
                document = document.then(operation, styles)
            except InputError as error:
                raise InputError(f"script: operation {i}: {operation.op}: {error}") from error
        return document

    def undone(self, styles: Styles) -> "Document":
        """The last operation taken back; the script says so."""
        return self.then(Undo(), styles)

    def redone(self, styles: Styles) -> "Document":
        """Done again; the script says so."""
        return self.then(Redo(), styles)

    def reset(self) -> "Document":
        """The shape as it was opened, with an empty script."""
        first = self
        while first.before is not None:
            first = first.before
        return first
