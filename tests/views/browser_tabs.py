"""Tabs of a real browser that many tests use one after the other: a new one costs a second of processor time."""

from collections import defaultdict
from collections.abc import Callable
from typing import Any
from urllib.parse import urljoin

from browser_sizes import SIZES

DEFAULT_TIMEOUT_MS = 30_000.0  # Playwright's own


class Tabs:
    """What tests open. At the end of one its tabs are empty and keep nothing, and wait for the next test of their language."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser
        self._free: defaultdict[str, list[Any]] = defaultdict(list)  # by locale: Playwright's pages, each of a context of its own
        self._used: list[tuple[str, Any]] = []
        self._heard: list[tuple[Any, str, Callable[..., None]]] = []

    def open(self, size: str = "desktop", scheme: str = "light", locale: str = "en-GB", *, reduced_motion: str = "no-preference") -> Any:
        """A page that has seen nothing; the second of a test is another person's."""
        free = self._free[locale]
        page = free.pop() if free else self._browser.new_context(locale=locale).new_page()
        self._used.append((locale, page))
        page.set_viewport_size(SIZES[size])
        page.emulate_media(color_scheme=scheme, reduced_motion=reduced_motion)
        return page

    def hear(self, page: Any, event: str, listener: Callable[..., None]) -> None:
        """Listen to an event of the page until the test ends."""
        page.on(event, listener)
        self._heard.append((page, event, listener))

    def clear(self) -> None:
        """Empty the tabs. Each stays at the site that it showed: for another one the browser would start another process."""
        for page, event, listener in self._heard:
            page.remove_listener(event, listener)
        self._heard.clear()
        while self._used:
            locale, page = self._used.pop()
            for other in page.context.pages:
                if other is not page:  # opened by a link
                    other.close()
            page.unroute_all()
            page.set_default_timeout(DEFAULT_TIMEOUT_MS)
            if page.url.startswith("http"):
                page.evaluate("localStorage.clear()")
                nothing = urljoin(page.url, "/nothing")  # the server would refuse it, and the browser tell that in the next test
                page.route(nothing, lambda asked: asked.fulfill(body=""))
                page.goto(nothing)
                page.unroute(nothing)
            else:
                page.goto("about:blank")
            page.context.clear_cookies()
            self._free[locale].append(page)
