"""The plant's screen in a real Chromium: by eye, keyboard and finger, light and dark, in both languages."""

import pytest
from plant_screen import ALERT, PlantOfATest, documents

pytestmark = pytest.mark.timeout(180)
MODELS = ("ur5e", "ur10e")


def many_arms():
    """26 arms of two sites and two models; one is sick, with an alert."""
    arms = {(f"hall-{k % 2 + 1}", f"cell-{k:02d}"): documents(model=MODELS[k % 2]) for k in range(25)}
    return {**arms, ("hall-2", "press-7"): documents("MAINTENANCE_REQUIRED", alerts=[ALERT])}


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """The screen of a small plant."""
    with PlantOfATest(tmp_path_factory.mktemp("plant"), arms=many_arms()) as made:
        yield made


@pytest.fixture
def opened(tabs, plant):
    """Open the screen; whatever the page complains about fails the test."""
    complaints = []

    def visit(size="desktop", scheme="light", locale="en-GB"):
        page = tabs.open(size, scheme, locale)
        tabs.hear(page, "pageerror", lambda error: complaints.append(str(error)))
        tabs.hear(page, "console", lambda message: complaints.append(message.text) if message.type in {"error", "warning"} else None)
        page.goto(plant.url)
        page.wait_for_function("document.querySelectorAll('#arms tbody tr').length === 26")
        return page

    yield visit
    assert complaints == []


@pytest.mark.parametrize(
    ("size", "scheme", "locale", "says"),
    [("desktop", "light", "en-GB", "Maintenance required"), ("phone", "dark", "de-DE", "Wartung")],
)
def test_the_sick_arm_stands_first_and_nothing_is_cut(opened, size, scheme, locale, says):
    """On both sizes, in both languages."""
    page = opened(size, scheme, locale)
    first = page.locator("#arms tbody tr").first
    assert "press-7" in first.inner_text()
    assert says in first.inner_text()
    assert page.locator("[data-grade=sick] b").inner_text() == "1"
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


def test_search_filters_and_keys(opened):
    """`/` searches, the arrows go through the arms, Enter opens one; filters join."""
    page = opened()
    page.keyboard.press("/")
    page.keyboard.type("hall-1 cell-0")
    assert page.locator("#arms tbody tr").count() == 5
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("document.activeElement.textContent") == "hall-1 / cell-02"
    page.fill("#search", "")
    page.select_option("#model", "ur10e")
    assert page.locator("#arms tbody tr").count() == 12
    page.click("[data-grade=sick]")
    assert page.locator("#arms tbody tr").count() == 0
    page.select_option("#model", "")
    page.locator("#arms tbody a").first.press("Enter")
    page.wait_for_selector("#verdict")
    page.wait_for_function("document.getElementById('robot').textContent.includes('press-7')")
    page.click("#home")
    page.wait_for_selector("#arms tbody tr")


def test_an_alert_is_acknowledged_with_name_and_reason(opened, plant):
    """The command goes to the arm."""
    page = opened()
    page.click("[data-act^='ack hall-2 / press-7']")
    page.fill("#by", "ada")
    page.fill("#reason", "parts are ordered")
    page.click("#ok")
    page.wait_for_selector("#dialog", state="hidden")
    key, document = next(asked for asked in reversed(plant.link.asked) if "cmd" in asked[0])
    assert key.endswith("hall-2/press-7/cmd/ack")
    assert document == {"joint": 3, "condition": "wear_rising", "by": "ada", "why": "parts are ordered"}


def test_a_joint_without_a_history_says_so_among_its_peers(opened):
    """A click on its number; Escape closes it."""
    page = opened()
    page.locator(".joints button").nth(2).click()
    page.wait_for_selector("#peers[open]")
    assert "Nothing is known of this joint yet." in page.locator("#peers").inner_text()
    page.keyboard.press("Escape")
    page.wait_for_selector("#peers", state="hidden")
