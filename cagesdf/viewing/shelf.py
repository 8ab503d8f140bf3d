"""The documents of one tab: a shape that is left is taken up again where it was left."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from cagesdf.editing.document import Document
from cagesdf.editing.parts import free_name
from cagesdf.editing.styles import Styles
from cagesdf.errors import InputError
from cagesdf.viewing.drafts import Draft, Entry
from cagesdf.viewing.uploads import Upload


@dataclass(eq=False)
class Shelf:
    """Documents by name; the names of a run's shapes are theirs."""

    fresh: Callable[[str], Document]  # a run's shape, by id, as it is opened; raises InputError
    ids: frozenset[str]  # the run's shapes
    keep: Callable[[Entry], None]  # called with each entry that changes
    entries: dict[str, Entry] = field(default_factory=dict)

    @property
    def made(self) -> list[str]:
        """Names of shapes that aren't the run's, newest first."""
        return [name for name in reversed(self.entries) if name not in self.ids]

    @property
    def unsaved(self) -> bool:
        """True if changes are in no file."""
        return any(entry.last.state is not entry.saved.state for entry in self.entries.values())

    def take(self, name: str) -> Document:
        """A document as it was left, or a run's shape. Raises InputError for another name."""
        if name not in self.entries:
            document = self.fresh(name)
            self.entries[name] = Entry(document, document, None, document)
        return self.entries[name].last

    def add(self, document: Document, upload: Upload | None) -> Document:
        """A document that was made here, under a free name."""
        document = document.named(free_name(document.name, [*self.entries, *self.ids]))
        # That it was made is something to save, too.
        self._put(Entry(document, document, upload, document.reset()))
        return document

    def put(self, document: Document) -> None:
        """Replace the document of that name."""
        entry = self.entries[document.name]
        self._put(replace(entry, last=document))

    def first(self, name: str) -> Document:
        """The document as it was at first."""
        return self.entries[name].first

    def reset(self, name: str) -> Document:
        """Take the document up as it was at first. What was done is kept until something else is."""
        entry = self.entries[name]
        self.entries[name] = replace(entry, last=entry.first)
        return entry.first

    def undone(self, name: str, styles: Styles) -> Document:
        """Without its last operation. Raises InputError where none is left that was done here."""
        entry = self.entries[name]
        if len(entry.last.history.past) <= len(entry.first.history.past):
            raise InputError("there is nothing to take back")
        return entry.last.undone(styles)

    def save(self, name: str) -> None:
        """It is in a file now."""
        entry = self.entries[name]
        self.entries[name] = replace(entry, saved=entry.last)

    def upload(self, name: str) -> Upload | None:
        """The file that a document comes from."""
        return self.entries[name].upload if name in self.entries else None

    def restore(self, draft: Draft, styles: Styles) -> Document:
        """The document of a draft, under its name, or one that is free. Raises InputError if its script fails."""
        first = self.fresh(draft.shape_id).continued(draft.script[: draft.made], styles)
        name = draft.name
        entry = self.entries.get(name)
        if name not in self.ids or (entry is not None and entry.last.script):
            name = free_name(name, [*self.entries, *self.ids])
        last = first.named(name).continued(draft.script[draft.made :], styles)
        self._put(Entry(first.named(name), last, draft.upload, first.reset()))
        return last

    def _put(self, entry: Entry) -> None:
        self.entries[entry.last.name] = entry
        self.keep(entry)
