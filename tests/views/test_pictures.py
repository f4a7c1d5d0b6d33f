"""The pictures of the documentation, taken in a real Chromium: `make pictures` writes them, the soak only takes them."""

import io
import os
from pathlib import Path

import pytest
from browser_sizes import SIZES
from lived_monitor import DAY_S, FIRST_UNIX_S, monitor
from PIL import Image
from plant_screen import ALERT, PlantOfATest, documents

from monitor.service.history.report import report
from monitor.store.store import Store
from monitor.views.language.catalogue import ENGLISH
from monitor.views.report.page import report_page

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: the page is not tested in a browser").expect

pytestmark = [pytest.mark.soak, pytest.mark.xdist_group("page"), pytest.mark.timeout(240)]
DOCS = Path(__file__).parents[2] / "docs"
DAYS = 33  # of wear whose limit is some weeks away
A4 = {"width": 688, "height": 1028}  # CSS pixels between the margins
COLOURS = 255  # of a picture: enough for a page, and a fifth of the bytes


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The page of an arm that moves, and what its history is made of."""
    with monitor(tmp_path_factory.mktemp("life"), days=DAYS) as (server, daemon, store):
        yield server, daemon, store


def kept(picture: bytes, name: str) -> Image.Image:
    """The picture; it replaces that of the documentation where JOINT_MONITOR_PICTURES is set."""
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    if os.environ.get("JOINT_MONITOR_PICTURES"):
        image.quantize(COLOURS, dither=Image.Dither.NONE).save(DOCS / name, optimize=True)
    return image


@pytest.mark.parametrize(
    ("name", "size", "scheme", "locale", "height"),
    [("page.png", "desktop", "light", "en-GB", 1330), ("page-phone.png", "phone", "dark", "de-DE", 1500)],
)
def test_the_page_has_its_picture(served, browser, name, size, scheme, locale, height):
    """The top of the page as a person sees it after some seconds, with alert, chart, arm and joints."""
    context = browser.new_context(viewport={**SIZES[size], "height": height}, color_scheme=scheme, locale=locale, timezone_id="UTC")
    page = context.new_page()
    page.goto(served[0].url)
    expect(page.locator("#active .proof canvas")).to_be_visible()
    expect(page.locator("#joints .sparkline polyline")).to_have_count(6)
    page.wait_for_timeout(3000)  # of torque
    image = kept(page.screenshot(), name)
    context.close()
    assert image.size == (SIZES[size]["width"], height)
    assert len(image.quantize(COLOURS).getcolors()) > 20  # a blank page has one


def test_the_plants_screen_has_its_picture(tmp_path, browser):
    """Forty arms of two halls: some sick, one in doubt, one whose state is of then."""
    arms = {(f"hall-{k % 2 + 1}", f"cell-{k:02d}"): documents(model=("ur5e", "ur10e")[k % 3 == 0]) for k in range(36)}
    arms["hall-1", "press-3"] = documents("FAILURE", alerts=[{**ALERT, "tier": "limit", "change": 0.31}])
    arms["hall-2", "press-7"] = documents("MAINTENANCE_REQUIRED", alerts=[ALERT])
    arms["hall-1", "weld-1"] = documents("OFF_SPEC")
    arms["hall-2", "weld-4"] = {**documents(), "health": {**documents()["health"], "stale": True}}
    with PlantOfATest(tmp_path, arms=arms) as plant:
        context = browser.new_context(viewport={**SIZES["desktop"], "height": 900}, color_scheme="light", locale="en-GB", timezone_id="UTC")
        page = context.new_page()
        page.goto(plant.url)
        expect(page.locator("#arms tbody tr")).to_have_count(40)
        image = kept(page.screenshot(), "plant.png")
        context.close()
    assert len(image.quantize(COLOURS).getcolors()) > 20


def test_the_report_has_its_picture(served, browser):
    """The one sheet of a quiet fortnight."""
    _, daemon, store = served
    settings = daemon.state.configuration
    with Store.reader(store.directory) as reader:
        quiet = report(settings, reader, FIRST_UNIX_S, FIRST_UNIX_S + 19 * DAY_S, FIRST_UNIX_S + DAYS * DAY_S)
    page = browser.new_page(viewport=A4)
    page.emulate_media(media="print")
    page.set_content(report_page([quiet], ENGLISH))
    page.add_style_tag(content="html { padding: 12mm }")
    image = kept(page.screenshot(full_page=True), "report.png")
    page.close()
    assert image.size[0] == A4["width"]
