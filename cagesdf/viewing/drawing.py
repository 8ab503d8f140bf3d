"""New styles and new shapes, drawn until one holds."""

from collections.abc import Callable, Iterable
from itertools import repeat

import numpy as np

from cagesdf.editing.document import Document
from cagesdf.editing.health import Health
from cagesdf.editing.script import Style
from cagesdf.editing.session import Live, Session
from cagesdf.editing.state import State
from cagesdf.errors import InputError
from cagesdf.extraction import PREVIEW, Each
from cagesdf.shape_generation.cages import draw_cages
from cagesdf.shape_generation.surfaces import CodeSource
from cagesdf.viewing.jobs import Progress
from cagesdf.viewing.opening import Opened
from cagesdf.viewing.worker import PREVIEW_CELLS

TRIES = 5  # draws at most of a style, or of a shape with its style


def in_new_style(
    opened: Opened, document: Document, rng: np.random.Generator, temperature: float, progress: Progress
) -> Document:
    """A document in a style that is drawn for its cuboids until the surface holds. Raises InputError."""
    progress("learning what fits the cuboids")
    codes = opened.codes()

    def draw() -> Document:
        return document.then(new_style(codes, rng, document.state, temperature), opened.session.styles)

    return first_that_holds(opened.session, repeat(draw), progress)


def new_shape(
    opened: Opened, start: Document, rng: np.random.Generator, temperature: float, progress: Progress
) -> Document:
    """New cuboids in a new style, drawn until the surface holds; `start` is what their script begins with.

    Raises InputError, also for a run without a generator.
    """
    if opened.generator is None:
        raise InputError("this run has no generator of new cuboids")
    progress("learning which styles fit which cuboids")
    generator, codes, styles = opened.generator, opened.codes(), opened.session.styles

    def draw() -> Document:
        samples = draw_cages(generator, rng, 1, temperature)
        if not samples.kept:
            raise InputError("; ".join(samples.failures))
        built = start.then(opened.build(samples.kept[0]), styles)
        return built.then(new_style(codes, rng, built.state, temperature), styles)

    return first_that_holds(opened.session, repeat(draw), progress)


def first_that_holds(session: Session, drawn: Iterable[Callable[[], Document]], progress: Progress) -> Document:
    """The first of at most TRIES drawn documents whose surface has as many components as its cuboids.

    Otherwise the one that is torn least. Draws that raise InputError are left out; if all do, InputError is raised.
    """
    live, each = session.live(PREVIEW_CELLS, fineness=PREVIEW), progress.each("surface of the draw")
    best, least, reasons = None, np.inf, []
    for number, (_, draw) in enumerate(zip(range(TRIES), drawn)):
        progress(f"draw {number + 1} of at most {TRIES}", number / TRIES)
        try:
            document = draw()
        except InputError as error:
            reasons.append(str(error))
            continue
        torn = tears(document.state, live, each)
        if torn < least:
            best, least = document, torn
        if not torn:
            break
    if best is None:
        raise InputError(f"no draw gave a shape to edit: {'; '.join(dict.fromkeys(reasons))}; lower the temperature")
    return best


def tears(state: State, live: Live, each: Each) -> int:
    """Number of parts that are torn or missing, plus components of the surface beyond those of the cuboids."""
    health = Health.of(live.surface(state, each), state, PREVIEW_CELLS, PREVIEW)
    return len(health.torn) + max(health.components - health.expected, 0)


def new_style(source: CodeSource, rng: np.random.Generator, state: State, temperature: float) -> Style:
    """A style that was drawn for a state's cuboids."""
    drawn = source.draw(rng, state.cage, temperature)
    parts = {part: tuple(latent.tolist()) for part, latent in drawn.part_latents.items()}
    return Style(code=tuple(drawn.latent.tolist()), parts=parts)
