"""A grid of pictures to click."""

from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import Any

import viser

from cagesdf.viewing.thumbnails import Picture, as_url, blank

COLUMNS = 3
# viser's buttons are rows of text; those with a picture become tiles of a grid.
STYLE = f"""<style>
div:has(> .mantine-Button-root img.tile) {{
  display: inline-block; vertical-align: top; width: {100 / COLUMNS - 1:.2f}%;
  margin: 0 0 4px 0.8% !important; padding: 0 !important;
}}
.mantine-Button-root:has(img.tile) {{
  height: auto !important; padding: 2px; background: white; border: 1px solid #8884;
  &:hover {{ border-color: #e8601c; }}
  .mantine-Button-inner {{ flex-direction: column; }}
  .mantine-Button-section {{ margin: 0; width: 100%; }}
  .mantine-Button-section > div {{ width: 100%; height: auto; }}
  .mantine-Button-label {{ color: #444; font-size: 10px; font-weight: 400; height: 1.4em; }}
}}
img.tile {{ width: 100%; aspect-ratio: 1; display: block; }}
</style>"""


class PictureGrid:
    """Names with pictures, in order; `pick` is called with the name that is clicked."""

    def __init__(self, gui: viser.GuiApi, title: str, pick: Callable[[str], None]) -> None:
        self._gui, self._pick = gui, pick
        self._names: list[str] = []
        self._tiles: list[Any] = []
        gui.add_html(STYLE)
        self._folder = gui.add_folder(title)

    def show(self, names: Sequence[str]) -> bool:
        """Show these names, without pictures yet. Returns whether they differ from those shown before."""
        if self._names == [*names]:
            return False
        self._names = list(names)
        with self._folder:
            for number in range(len(self._tiles), len(names)):
                tile = self._gui.add_button(names[number])
                tile.on_click(partial(lambda number, _: self._pick(self._names[number]), number))
                self._tiles.append(tile)
        while len(self._tiles) > len(names):
            self._tiles.pop().remove()
        for name, tile in zip(names, self._tiles):
            tile.label = name
            _put(tile, as_url(blank()))
        return True

    def put(self, name: Hashable, picture: Picture) -> None:
        """Set the picture of a name, if the name is still shown."""
        if name in self._names:
            _put(self._tiles[self._names.index(name)], as_url(picture))


def _put(tile: Any, url: str) -> None:
    # viser's own icons are HTML in this property, too, which has no public name for other pictures.
    tile._icon_html = f'<img class="tile" src="{url}">'
