"""A browser for the tests, and an editor for it to open.

Chromium is Debian's (`apt-get install chromium`), or the one that CAGESDF_CHROMIUM names. Where there is none the tests
try to install it, and are skipped, with the reason, only where that can't be done; in CI they fail instead.
Screenshots are kept in CAGESDF_SCREENSHOTS, or in pytest's temporary folder.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from playwright.sync_api import Browser, ViewportSize, sync_playwright

from cagesdf.api.sources import IMPORT
from cagesdf.demo import DEMO
from cagesdf.inference.shapes import usual_settings
from cagesdf.viewing.opening import opened
from cagesdf.viewing.server import Editor, serving
from tests.support.chromium import FLAGS, chromium
from tests.support.page import PATIENCE, EditorPage

SIZE = ViewportSize(width=1280, height=800)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    path = chromium()
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(
            executable_path=path, headless=True, args=list(FLAGS), timeout=1000 * PATIENCE
        )
        yield running
        running.close()


@pytest.fixture(scope="session")
def editor() -> Iterator[Editor]:
    """The demo, at an address of its own."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    usual = usual_settings()
    quick = replace(usual, inference=replace(usual.inference, tried=4, starts=1, code_steps=20, residual_steps=60))
    demo = opened(DEMO / "run", None, DEMO / "programs", None, IMPORT, quick)
    with serving({"demo": demo, "again": demo}, "127.0.0.1", 0, 2) as running:
        yield running
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def screenshots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = os.environ.get("CAGESDF_SCREENSHOTS")
    return Path(folder) if folder else tmp_path_factory.mktemp("screenshots")


@pytest.fixture
def visit(browser: Browser, editor: Editor, screenshots: Path) -> Iterator[Callable[[], EditorPage]]:
    """Opens the editor in a new tab, once more with each call. At the end no page may have complained."""
    with visiting(browser, editor, screenshots) as come:
        yield come


@contextmanager
def visiting(browser: Browser, editor: Editor, screenshots: Path) -> Iterator[Callable[[], EditorPage]]:
    """A function that opens the editor in a new tab."""
    pages: list[EditorPage] = []

    def come() -> EditorPage:
        page = browser.new_page(viewport=SIZE, accept_downloads=True)
        pages.append(EditorPage(page, editor.address, screenshots))
        return pages[-1]

    yield come
    for page in pages:
        page.close()
    assert [text for page in pages for text in page.errors] == []
