"""A real browser for the tests of the page."""

import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest
from browser_tabs import Tabs

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def on_the_last_core() -> Iterator[None]:
    """What is started within stays on one core.

    A browser begins sessions of its own, and Linux shares a core among sessions (autogroup) before it asks which process gives way: on
    every core it would hold up an arm in real time.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


@pytest.fixture(scope="session")
def browser():
    """A running Chromium. A test that needs it is skipped where none is installed."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed (Debian: apt-get install chromium): the page is not tested in a browser")
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: the page is not tested in a browser")
    with ExitStack() as stack:
        with on_the_last_core():
            playwright = stack.enter_context(sync_api.sync_playwright())
            running = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        stack.callback(running.close)
        yield running


@pytest.fixture(scope="session")
def tabs_of_all(browser):
    """The tabs of this run."""
    return Tabs(browser)


@pytest.fixture
def tabs(tabs_of_all):
    """Tabs as if nobody had used them. A test that ends the server clears them before: the next would hear the page's complaint."""
    yield tabs_of_all
    tabs_of_all.clear()
