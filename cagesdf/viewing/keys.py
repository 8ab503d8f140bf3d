"""Keys of the editor: Blender's where they are free. viser's command palette (Ctrl+K) lists them, too.

viser flies with CAMERA_KEYS, whatever is held with them: a key of the editor among them would move the view, too.
"""

from dataclasses import dataclass
from typing import Any

CAMERA_KEYS = "WASDQE"
KEY_NAMES = {"cmd/ctrl": "Ctrl", "shift": "Shift", "alt": "Alt", "delete": "Delete", "escape": "Esc"}


@dataclass(frozen=True)
class Key:
    """A key, or one with others held, and what it does."""

    does: str  # in the card
    key: Any  # viser's name
    held: Any = None  # modifiers, as viser writes them; None: no other key

    def __str__(self) -> str:
        parts = [*(self.held.split("+") if self.held else []), self.key]
        return "+".join(KEY_NAMES.get(part, part) for part in parts)


KEYS: dict[str, tuple[Key, ...]] = {  # by action
    "move": (Key("Move", "G"),),
    "turn": (Key("Turn", "R"),),
    "resize": (Key("Resize", "L"),),
    "undo": (Key("Undo", "Z", "cmd/ctrl"),),
    "redo": (Key("Redo", "Z", "cmd/ctrl+shift"), Key("Redo", "Y", "cmd/ctrl")),
    "nothing": (Key("Select nothing", "escape"),),
    "everything": (Key("Select everything", "B"),),
    "duplicate": (Key("Duplicate", "N"),),
    "delete": (Key("Delete", "delete"), Key("Delete", "X")),
    "hide": (Key("Hide the selection", "H"),),
    "show": (Key("Show everything", "H", "shift"), Key("Show everything", "H", "alt")),
    "frame": (Key("Frame the selection", "F"),),
    "front": (Key("Front view", "1"),),
    "side": (Key("Side view", "3"),),
    "top": (Key("Top view", "7"),),
    "perspective": (Key("Perspective view", "5"),),
    "look": (Key("Parts, clay, wireframe", "Z"),),
    "cuboids": (Key("Cuboids on or off", "C"),),
    "help": (Key("This card", "I"),),
}

MOUSE = (
    ("Click", "select a cuboid; again: the one behind it"),
    ("Shift+click", "select more"),
    ("Drag", "turn the view; with the right button: move it; wheel: zoom"),
    ("W A S D Q E", "fly"),
)


def card() -> str:
    """All keys as a Markdown table."""
    rows = [(" or ".join(map(str, keys)), keys[0].does.lower()) for keys in KEYS.values()]
    lines = [f"| **{key}** | {does} |" for key, does in (*MOUSE, *rows)]
    return "\n".join(["| | |", "|---|---|", *lines])
