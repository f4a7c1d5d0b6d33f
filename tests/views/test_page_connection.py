"""The page in a real Chromium when alerts, problems and the connection to the monitor come and go.

It is skipped where no Chromium or Playwright is installed.
"""

from dataclasses import replace

import pytest
from browser_sizes import SIZES
from lived_monitor import DAY_S, FIRST_UNIX_S, configuration, monitor
from published import raw

from monitor.publish.timestamps import rfc3339

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: the page is not tested in a browser").expect

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.timeout(240)]
ALERT = {
    "active": True,
    "raised_at": "2026-06-01T03:00:00Z",
    "updated_at": "2026-06-01T03:00:00Z",
    "change": 0.0,
    "probability": 1.0,
    "text": "<img src=x onerror=alert(1)> " + "W" * 300,
    "action": "Look.",
}
MANY = [
    (1, "wear_rising", "wear", {}),
    (2, "sudden_step", "limit", {}),
    (3, "friction_falling", "advisory", {}),
    (4, "temperature_sensor", "advisory", {}),
    (5, "wear_rising", "advisory", {}),
    (6, "wear_rising", "limit", {"acknowledged_at": "2026-06-02T03:00:00Z", "acknowledged_by": "A" * 200}),
    (6, "data_quality", "advisory", {"shelved_until": "2030-01-01T00:00:00Z", "shelved_by": "Grace", "shelved_why": "spare on its way"}),
    (None, "common_mode", "advisory", {}),
]


@pytest.fixture
def blank(tmp_path, browser):
    """The page of a monitor without history, on a phone. Text that the page takes for markup fails the test."""
    settings = configuration(tmp_path)
    settings = replace(settings, robot=replace(settings.robot, tool="t" * 200))
    with monitor(tmp_path, days=0, settings=settings, moving=False) as (server, daemon, store):
        page = browser.new_page(viewport=SIZES["phone"])
        wrong = []
        page.on("dialog", lambda dialog: wrong.append(dialog.message))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.clock.install()
        page.goto(server.url)
        expect(page.locator("#link")).to_have_text("live")
        yield page, daemon, store
        page.close()
        assert not wrong


def test_the_focus_stays_at_an_alert_when_others_change(blank):
    """With eight alerts and endless words nothing is wider than the window, waiting ones come first, and every button has its own label."""
    page, daemon, _ = blank
    for joint, condition, tier, more in MANY:
        daemon.bus.say(raw("alert", {"joint": joint, "condition": condition, "tier": tier, **ALERT, **more}))
    cards = page.locator("#active .alert")
    expect(cards).to_have_count(8)
    expect(page.locator("#count")).to_have_text("6")  # neither acknowledged nor shelved
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert cards.evaluate_all("all => all.map(one => one.dataset.key)") == [
        "2/sudden_step", "1/wear_rising", "3/friction_falling", "4/temperature_sensor", "5/wear_rising", "null/common_mode",
        "6/wear_rising", "6/data_quality",
    ]  # fmt: skip
    labels = page.locator("#active button").evaluate_all("all => all.map(one => one.getAttribute('aria-label') || one.textContent)")
    assert len({label for label in labels if "Look" not in label}) == sum("Look" not in label for label in labels) == 21
    expect(page.locator('[data-key="5/wear_rising"]')).to_have_attribute("data-state", "NOTICE")  # its joint is NORMAL
    # a condition of the data has no probability
    assert "Probability" not in page.locator('[data-key="4/temperature_sensor"]').text_content()
    assert "has fallen" in page.locator('[data-key="3/friction_falling"]').text_content()
    page.locator('[data-key="4/temperature_sensor"] [data-do="ack"]').focus()
    before = cards.first.element_handle()
    daemon.bus.say(raw("alert", {"joint": 1, "condition": "wear_rising", "tier": "wear", **ALERT, "text": "said anew"}))
    expect(page.locator('[data-key="1/wear_rising"]')).to_contain_text("said anew")
    assert not before.evaluate("one => one.isConnected")  # all cards were replaced
    assert page.evaluate("document.activeElement.closest('.alert').dataset.key + document.activeElement.dataset.do") == (
        "4/temperature_sensorack"
    )
    # wrong hours, typed for shelving, do not prevent an acknowledgement
    page.locator('[data-key="4/temperature_sensor"] [data-do="shelve"]').click()
    page.locator("#hours").fill("99999")
    page.keyboard.press("Escape")
    page.locator('[data-key="4/temperature_sensor"] [data-do="ack"]').click()
    page.locator("#by").fill("Ada")
    page.locator("#ok").click()
    expect(page.locator("#problem")).to_contain_text("no active alert")  # this is the daemon's answer, so the command was sent
    asked_from = page.locator('[data-key="4/temperature_sensor"] [data-do="ack"]').element_handle()
    daemon.bus.say(raw("alert", {"joint": 1, "condition": "wear_rising", "tier": "wear", **ALERT, "text": "again"}))
    expect(page.locator('[data-key="1/wear_rising"]')).to_contain_text("again")
    assert not asked_from.evaluate("one => one.isConnected")  # the browser has nothing left to which it could return
    page.keyboard.press("Escape")
    expect(page.locator('[data-key="4/temperature_sensor"] :focus')).to_have_count(1)  # a closed dialog gives it back a moment later


def test_an_arm_that_is_not_received_is_shown_at_the_top_without_live_torque(blank):
    """A problem comes and goes with the documents of the bus; an old sample is never shown as live torque."""
    page, daemon, store = blank
    problem = {"name": "arm", "since": "2026-06-01T03:00:00Z", "text": "connection refused"}
    daemon.bus.say(raw("monitor", {"troubles": [problem]}))
    expect(page.locator("#troubles")).to_contain_text("The arm is not heard since")
    expect(page.locator("#troubles")).to_contain_text("connection refused")
    daemon.bus.say(raw("monitor", {"troubles": []}))
    expect(page.locator("#troubles")).to_be_empty()
    sample = {name: [0.0] * 6 for name in ("q_rad", "predicted_nm", "std_nm", "measured_nm", "residual_nm", "extrapolated")}
    daemon.bus.say(raw("torque-live", {"at": rfc3339(FIRST_UNIX_S + DAY_S), **sample}))
    expect(page.locator("#torque-figure")).to_be_hidden()  # at standstill, torque says nothing of friction
    daemon.bus.say(raw("torque-live", {"at": rfc3339(FIRST_UNIX_S + DAY_S), **sample, "q_rad": [0.5] * 6}))
    expect(page.locator("#torque canvas")).to_be_visible()
    page.clock.fast_forward(16_000)
    expect(page.locator("#torque")).to_contain_text("Nothing is heard of the arm since")
    expect(page.locator("#residual")).to_be_empty()
    daemon.bus.say(raw("torque-live", {"at": rfc3339(FIRST_UNIX_S), **sample}))
    store.stops.add("protective_stop", "safety mode 3", FIRST_UNIX_S)
    page.reload()
    expect(page.locator("#torque")).to_contain_text("Nothing is heard of the arm since")
    expect(page.locator("#troubles")).to_contain_text("Nothing moves until a person has looked at the arm")


def test_a_silent_monitor_is_noticed_and_found_again(blank):
    """The stream stops without an end or an error, as when a telephone leaves the network; after 20 s the page says so."""
    page, _, _ = blank
    page.route("**/api/live*", lambda route: route.abort())
    page.clock.fast_forward(21_000)
    expect(page.locator("#link")).to_have_text("not connected")
    expect(page.locator("#lost")).to_contain_text("all that stands here is of then")
    assert page.title().startswith("NOT CONNECTED")
    page.unroute("**/api/live*")
    page.clock.fast_forward(21_000)
    expect(page.locator("#link")).to_have_text("live")
    expect(page.locator("#lost")).to_be_hidden()


def test_a_page_whose_session_has_ended_asks_for_the_token_again(browser, tmp_path):
    """A session ends after a day's work or with the monitor. The page says so by its sign-in, and not that nothing is heard."""
    (tmp_path / "token").write_text("a token of this test")
    settings = configuration(tmp_path, token_file="token")
    with monitor(tmp_path, days=0, settings=settings, moving=False) as (server, _, _):
        page = browser.new_page()
        page.clock.install()
        page.goto(server.url)
        page.get_by_label("Token").fill("a token of this test")
        page.get_by_role("button", name="Sign in").click()
        expect(page.locator("#link")).to_have_text("live")
        page.context.clear_cookies()
        page.clock.fast_forward(21_000)
        expect(page.get_by_label("Token")).to_be_visible()
        page.close()
