"""The list of parts beside the view: a part's name in its colour and its eye, in folders as the structure has them."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import viser

from cagesdf.editing.naming import group_names
from cagesdf.editing.parts import part_names
from cagesdf.editing.state import State
from cagesdf.structure.base import Structure
from cagesdf.viewing.colours import Colour
from cagesdf.viewing.selection import Selection

BUTTONS = {
    "Selected": ("Hide", "Lock", "Show all"),
    "Copy": ("Duplicate", "One more"),
    "Edit": ("Split", "Delete", "Add"),
}
WIDTH = 250  # pixels
LONGEST = 22  # letters of a folder's name
EYE = 34  # pixels
# viser's buttons are rows; an eye stands in the row of the name before it.
STYLE = f"""<style>
div:has(> .mantine-Button-root .icon-tabler-eye), div:has(> .mantine-Button-root .icon-tabler-eye-off) {{
  display: inline-block; vertical-align: top; width: {EYE}px; margin: 0 !important; padding: 0 !important;
  .mantine-Button-root {{ padding: 0; background: none; color: var(--mantine-color-text); }}
  .mantine-Button-section {{ margin: 0; }}
}}
div:has(+ div > .mantine-Button-root .icon-tabler-eye), div:has(+ div > .mantine-Button-root .icon-tabler-eye-off) {{
  display: inline-block; vertical-align: top; width: calc(100% - {EYE}px - 1em);
  margin: 0 0 5px 0.6em !important; padding: 0 !important;
}}
</style>"""


class PartList:
    """A panel at the left. Parts that are selected or locked have a sign, hidden ones a closed eye."""

    def __init__(
        self,
        client: viser.ClientHandle,
        pick: Callable[[tuple[str, ...], bool], None],
        blink: Callable[[str], None],
        act: Callable[[str], None],
        guard: Callable[[Callable[[], None]], None],
    ) -> None:
        """`pick` is called with the parts of an entry and whether they are added, `blink` with the part whose eye is
        clicked, `act` with the word of a button."""
        self._gui, self._pick, self._blink, self._guard = client.gui, pick, blink, guard
        self._panel = self._gui.add_panel()
        self._panel.dock_left()
        self._panel.set_width(WIDTH)
        self._tab = self._panel.add_tab("Parts")
        with self._tab:
            self._gui.add_html(STYLE)
            for label, words in BUTTONS.items():
                buttons = self._gui.add_button_group(label, words)
                buttons.on_click(partial(lambda group, _: guard(lambda: act(group.value)), buttons))
            self.more = self._gui.add_checkbox("Select several", False, hint="or shift-click in the view")
        self._folder: Any = None
        self._buttons: dict[str, Any] = {}
        self._eyes: dict[str, Any] = {}
        self._sets: dict[tuple[str, ...], tuple[str, Any]] = {}  # by parts: label and button that selects them
        self._shown: tuple[object, ...] = ()

    def show(self, state: State, colours: Mapping[str, Colour], selection: Selection) -> None:
        """The parts of a state; made anew only for other parts, names or colours."""
        names = part_names(state.structure)
        content = (tuple(names.items()), tuple(colours.items()))
        if content != self._shown:
            if self._folder is not None:
                self._folder.remove()
            self._shown, self._buttons, self._eyes, self._sets = content, {}, {}, {}
            with self._tab:
                self._folder = self._gui.add_folder("Parts")
            with self._folder:
                self._add_groups(state.structure, names)
                groups = group_names(state.structure)
                self._add(state.structure, state.structure.root(), names | groups, colours)
        for parts, (label, button) in self._sets.items():
            _show_label(button, label, {*parts} <= {*selection.parts})
        for part, button in self._buttons.items():
            _show_label(button, names[part], part in selection.parts)
            _show_icon(button, viser.Icon.LOCK if part in selection.locked else None)
            _show_icon(self._eyes[part], viser.Icon.EYE_OFF if part in selection.hidden else viser.Icon.EYE)

    def _add_groups(self, structure: Structure, names: Mapping[str, str]) -> None:
        """A button for all parts of each label that several have."""
        labels = structure.labels()
        for label in dict.fromkeys(labels.values()):
            parts = tuple(part for part in names if labels[part] == label)
            if label:
                self._add_set(f"all {len(parts)}: {label}", parts)

    def _add_set(self, label: str, parts: tuple[str, ...]) -> None:
        """A button for several parts that have none yet."""
        if len(parts) > 1 and parts not in self._sets:
            self._sets[parts] = label, self._button(label, parts, None)

    def _add(self, structure: Structure, node: str, names: Mapping[str, str], colours: Mapping[str, Colour]) -> None:
        for child in structure.children(node):
            if child in colours:
                self._buttons[child] = self._button(names[child], (child,), colours[child])
                self._eyes[child] = self._eye(child)
            else:
                text = names[child]
                with self._gui.add_folder(text if len(text) <= LONGEST else f"{text[:LONGEST]}…"):
                    inside = tuple(part for part in _leaves(structure, child) if part in colours)
                    self._add_set(f"these {len(inside)}", inside)
                    self._add(structure, child, names, colours)

    def _button(self, label: str, parts: tuple[str, ...], colour: Colour | None) -> Any:
        button = self._gui.add_button(label, color=colour or "gray")
        button.on_click(lambda _: self._guard(lambda: self._pick(parts, bool(self.more.value))))
        return button

    def _eye(self, part: str) -> Any:
        eye = self._gui.add_button("", icon=viser.Icon.EYE)
        eye.on_click(lambda _: self._guard(lambda: self._blink(part)))
        return eye


def _leaves(structure: Structure, node: str) -> Iterator[str]:
    """Ids below a node that have no children."""
    children = structure.children(node)
    for child in children:
        yield from _leaves(structure, child)
    if not children:
        yield node


def _show_label(button: Any, text: str, selected: bool) -> None:
    label = f"▸ {text}" if selected else text
    if button.label != label:
        button.label = label


def _show_icon(button: Any, icon: viser.IconName | None) -> None:
    if button.icon != icon:
        button.icon = icon
