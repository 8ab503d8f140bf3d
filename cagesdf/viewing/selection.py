"""Parts that are selected, hidden and locked."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from cagesdf.editing.parts import part_names
from cagesdf.errors import InputError
from cagesdf.structure.base import Structure


@dataclass(frozen=True)
class Selection:
    """A tab's choice of parts, by id. Each method returns another selection."""

    parts: tuple[str, ...] = ()  # selected, in the order of clicks
    hidden: frozenset[str] = frozenset()  # in the view
    locked: frozenset[str] = frozenset()  # not to be changed

    def of(self, parts: Sequence[str]) -> "Selection":
        """These parts selected, no others."""
        return replace(self, parts=tuple(parts))

    def within(self, known: Collection[str]) -> "Selection":
        """The selected parts that are among the known ones."""
        return self.of([part for part in self.parts if part in known])

    def clicked(self, parts: Sequence[str], more: bool) -> "Selection":
        """The selection after a click in the view on `parts`, nearest first.

        The nearest one; when that alone was selected already, the next behind it, so that what is hidden can be
        reached. With `more` the nearest is added to the others, or taken from them. Nothing, where nothing was clicked.
        """
        if not parts:
            return self if more else self.of(())
        if more:
            rest = [part for part in self.parts if part != parts[0]]
            return self.of(rest if parts[0] in self.parts else (*rest, parts[0]))
        if len(self.parts) == 1 and self.parts[0] in parts:
            return self.of([parts[(parts.index(self.parts[0]) + 1) % len(parts)]])
        return self.of(parts[:1])

    def listed(self, parts: Sequence[str], more: bool) -> "Selection":
        """The selection after a click on an entry of the list, which may be several parts.

        With `more` they are added, or taken away if they are all selected.
        """
        if not more:
            return self.of(parts)
        if set(parts) <= set(self.parts):
            return self.of([part for part in self.parts if part not in parts])
        return self.of(tuple(dict.fromkeys((*self.parts, *parts))))

    def hide(self) -> "Selection":
        """The selected parts hidden, and none selected."""
        return replace(self, parts=(), hidden=self.hidden | set(self.parts))

    def blink(self, part: str) -> "Selection":
        """A part hidden, or shown again; hidden parts aren't selected."""
        hidden = self.hidden ^ {part}
        return replace(self.of([other for other in self.parts if other not in hidden]), hidden=hidden)

    def show_all(self) -> "Selection":
        """No part hidden."""
        return replace(self, hidden=frozenset())

    def lock_or_free(self) -> "Selection":
        """The selected parts locked, or unlocked if all of them were locked."""
        parts = frozenset(self.parts)
        return replace(self, locked=self.locked - parts if parts <= self.locked else self.locked | parts)

    def names(self, structure: Structure) -> list[str]:
        """Names of the selected parts."""
        names = part_names(structure)
        return [names[part] for part in self.parts]

    def pattern(self, structure: Structure) -> str:
        """The selected parts, for an operation. Raises InputError where nothing is selected, or a part is locked."""
        if not self.parts:
            raise InputError("no part is selected; click those that are meant")
        names = self.names(structure)
        for part, name in zip(self.parts, names):
            if part in self.locked:
                raise InputError(f"{name} is locked; select it in the list and press Lock again")
        return "|".join(names)
