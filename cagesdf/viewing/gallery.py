"""Pictures of the shapes that can be opened or whose style can be taken, and of the principal directions."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from cagesdf.editing.state import State
from cagesdf.editing.styles import ranked
from cagesdf.structure.base import Structure
from cagesdf.viewing.opening import Opened
from cagesdf.viewing.panel import Panel
from cagesdf.viewing.pictures import PictureGrid
from cagesdf.viewing.thumbnails import Picture, blank

AT_FIRST = 9  # shapes or styles, and as many more by each *More*


class Gallery:
    """The pictures of one tab's panel. They are drawn in the background."""

    def __init__(self, opened: Opened, panel: Panel) -> None:
        self._opened, self._panel = opened, panel
        self._shapes_shown, self._styles_shown = 0, AT_FIRST
        self._ranked: tuple[Structure, list[str]] | None = None
        self._ends: dict[tuple[str, int, int], Picture] = {}  # by shape, direction and end
        self._shape = ""  # whose ends are shown

    def show_more_shapes(self) -> None:
        """The first shapes of the run, and some more of them by each call."""
        self._shapes_shown += AT_FIRST
        self._want("shapes", self._panel.show_trained(self._shapes_shown), self._panel.trained)

    def show_styles(self, state: State) -> None:
        """The styles, those that fit best first; a new order where the structure is another one."""
        if self._ranked is None or self._ranked[0] is not state.structure:
            self._ranked = state.structure, ranked(state, self._opened.session.styles)
        names = self._ranked[1]
        if self._panel.show_styles(names, self._styles_shown):
            self._want("styles", names[: self._styles_shown], self._panel.styles)

    def show_more_styles(self, state: State) -> None:
        """Some more of the styles."""
        self._styles_shown += AT_FIRST
        self.show_styles(state)

    def show_ends(self, shape_id: str) -> None:
        """A shape of the run at both ends of each principal direction."""
        if shape_id == self._shape:
            return
        self._shape, self._ends = shape_id, {}
        states = {
            (shape_id, direction, end): partial(self._at, shape_id, direction, end)
            for direction in range(len(self._opened.styles.directions))
            for end in (0, 1)
        }
        self._opened.thumbnails.want((id(self), "ends"), states, self._show_end)

    def close(self) -> None:
        """Order no more pictures."""
        for kind in ("shapes", "styles", "ends"):
            self._opened.thumbnails.forget((id(self), kind))

    def _want(self, kind: str, names: Sequence[str], grid: PictureGrid) -> None:
        states = {name: partial(self._opened.session.opened, name) for name in names}
        self._opened.thumbnails.want((id(self), kind), states, grid.put)

    def _at(self, shape_id: str, direction: int, end: int) -> State:
        state, space = self._opened.session.opened(shape_id), self._opened.styles
        return replace(state, latent=space.moved(state.latent, direction, float(space.ends[direction, end])))

    def _show_end(self, key: tuple[str, int, int], picture: Picture) -> None:
        shape_id, direction, _ = key
        if shape_id == self._shape:
            self._ends[key] = picture
            pair = [self._ends.get((shape_id, direction, end), blank()) for end in (0, 1)]
            self._panel.ends[direction].image = np.hstack(pair)
