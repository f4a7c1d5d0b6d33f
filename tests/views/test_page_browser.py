"""The page in a real Chromium: clicked through, by keyboard, on a phone, light and dark, without a network.

Skips, saying so, where no Chromium or Playwright is installed.
"""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from lived_monitor import DAY_S, FIRST_UNIX_S, configuration, monitor

from monitor.judge.document import plain
from monitor.judge.temperature.curves import Curve
from monitor.judge.temperature.laws import Line
from monitor.publish.timestamps import rfc3339

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
if CHROMIUM is None:
    pytest.skip("no Chromium is installed (Debian: apt-get install chromium): the page is not tested in a browser", allow_module_level=True)
sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: the page is not tested in a browser")
expect = sync_api.expect

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.timeout(240)]
SIZES = {"desktop": {"width": 1366, "height": 900}, "phone": {"width": 390, "height": 844}}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Forty days of an arm whose elbow wears; it moves."""
    with monitor(tmp_path_factory.mktemp("life"), days=40) as (server, daemon, store):
        yield server, daemon, store


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture
def opened(served, browser):
    """A page of a size and scheme; whatever the browser complains about, or asks of another host, fails the test."""
    server, _, _ = served
    contexts, trouble = [], []

    def open_(size="desktop", scheme="light"):
        context = browser.new_context(viewport=SIZES[size], color_scheme=scheme, reduced_motion="reduce")
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(20_000)
        # the test itself reads pixels, and is told that it could do so faster
        page.on(
            "console",
            lambda message: (
                trouble.append(message.text) if message.type in {"error", "warning"} and "getImageData" not in message.text else None
            ),
        )
        page.on("pageerror", lambda error: trouble.append(str(error)))
        page.on("request", lambda request: None if request.url.startswith((server.url, "data:")) else trouble.append(request.url))
        page.goto(server.url)
        expect(page.locator("#link")).to_have_text("live")
        expect(page.locator("#windows tbody tr").first).to_be_visible()
        return page

    yield open_, trouble
    for context in contexts:
        context.close()
    assert not trouble


def test_the_state_of_the_arm_is_seen_at_once(opened):
    """The verdict, the alert with evidence, the joint that wears in drawing, table and tabs, its charts, and what is live."""
    page = opened[0]()
    expect(page.locator("#state")).to_contain_text("Maintenance required")
    expect(page.locator("#active .alert")).to_have_count(1)
    expect(page.locator("#active .alert")).to_contain_text("Joint 3: Wear rising")
    expect(page.locator("#arm .joint")).to_have_count(6)
    expect(page.locator('#arm .joint[data-state="MAINTENANCE_REQUIRED"]')).to_have_count(1)
    expect(page.locator('#arm .joint[data-state="NORMAL"]')).to_have_count(5)
    expect(page.locator("#joints tbody tr")).to_have_count(6)
    expect(page.locator("#which")).to_have_text("3")  # the first look is at the joint that matters most
    expect(page.locator("#old")).to_be_hidden()
    assert re.search(r"friction now 2\d\.\d % above.*; limit \d+ days after", page.locator("#wear").get_attribute("aria-label"))
    assert "% per kelvin" in page.locator("#law").get_attribute("aria-label")
    expect(page.locator("#torque canvas")).to_be_visible()
    assert page.title().startswith("Maintenance required: cell-1")
    page.locator("#active summary").click()
    expect(page.locator("#active .alert")).to_contain_text("of it temperature")


def test_torque_and_drawing_move_with_the_arm(opened):
    """Two looks a second apart differ, and every chart has ink on it."""
    page = opened[0]()
    before = page.locator("#arm .link").nth(2).get_attribute("points"), page.locator("#torque").get_attribute("aria-label")
    page.wait_for_timeout(3000)
    after = page.locator("#arm .link").nth(2).get_attribute("points"), page.locator("#torque").get_attribute("aria-label")
    assert before[0] != after[0]
    assert before[1] != after[1]
    for chart, colour in (("wear", "--line1"), ("law", "--line2"), ("torque", "--line1"), ("torque", "--line2")):
        inked = page.evaluate(
            """([id, name]) => {
                const probe = document.createElement("i"); probe.style.color = `var(${name})`; document.body.append(probe);
                const want = getComputedStyle(probe).color.match(/\\d+/g).map(Number); probe.remove();
                const canvas = document.querySelector(`#${id} canvas`);
                const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
                let n = 0;
                for (let k = 0; k < data.length; k += 4) if (data[k + 3] > 200 && want.every((c, i) => Math.abs(c - data[k + i]) < 12)) n++;
                return n; }""",
            [chart, colour],
        )
        assert inked > 10, (chart, colour)  # pixels: an empty chart has none, and a line of three seconds has some


def test_the_law_drawn_is_the_one_that_foresees_torque(opened):
    """A straight line, an exponential and Vogel's law, as `Line.at` answers, with twice its deviation either side."""
    page, zero, T0 = opened[0](), np.zeros(3), np.array([24.0, 27.0, 30.0])
    cov = np.tile([[4e-4, -2e-6], [-2e-6, 1e-6]], (3, 1, 1))
    a, b, pole_c = np.array([0.0, 2.0, 2.0]), np.array([0.0, -0.016, 800.0]), np.array([0.0, 0.0, -100.0])
    curve = Curve(np.array([0.0, 1.0, 2.0]), a, b, pole_c, T0, cov, np.zeros((3, 3)))
    level, slope, range_c = np.full(3, 7.5), np.full(3, -0.1), np.tile([8.0, 42.0], (3, 1))
    line = Line(reference_c=T0, intercept=level, slope=slope, cov=cov, scatter=zero, range_c=range_c, margin_k=3.0, curve=curve)
    for joint in (1, 2, 3):
        drawn = page.evaluate(
            """([model, joint]) => {
                const charts = new Charts();
                charts.law({ temperature_c: [8, 42], viscous_nm_s_per_rad: [9, 5], wear: [0, 0] }, model, joint);
                return charts.plots.law.data.map((one) => Array.from(one)); }""",
            [{"viscous": plain(line)}, joint],
        )
        T, _, law, above, below = (np.array(one, dtype=float) for one in drawn)
        says = line.at(np.repeat(T[:, None], 3, axis=1))
        value, std = says.value[:, joint - 1], says.std[:, joint - 1]
        assert np.allclose(law, value)
        assert np.allclose(above, value + 2 * std)
        assert np.allclose(below, value - 2 * std)


def test_choosing_a_joint_in_drawing_table_or_tabs_shows_it_everywhere(opened):
    """By mouse."""
    page = opened[0]()
    for joint, where in ((5, "#arm .joint >> nth=4"), (2, "#joints tbody tr >> nth=1"), (6, "#tab-6")):
        page.locator(where).click()
        expect(page.locator("#which")).to_have_text(str(joint))
        expect(page.locator(f"#tab-{joint}")).to_have_attribute("aria-selected", "true")
        expect(page.locator("#joints tr.on")).to_contain_text(f"J{joint}")
        assert f"Joint {joint}:" in page.locator("#wear").get_attribute("aria-label")


def test_everything_can_be_done_by_keyboard(opened, served):
    """Tabs by arrows, a joint of the drawing by Enter, the dialog by Tab, Escape and Enter; focus is always seen."""
    _, _, store = served
    page = opened[0]()
    # by Tab one comes to things in the order in which the eye does
    tops = page.evaluate("[...document.querySelectorAll('main > section')].map((one) => one.getBoundingClientRect().top)")
    assert tops == sorted(tops)
    page.locator("#tab-3").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#which")).to_have_text("4")
    page.keyboard.press("End")
    expect(page.locator("#which")).to_have_text("6")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#which")).to_have_text("1")
    page.locator("#arm .joint").nth(2).focus()
    page.keyboard.press("Enter")
    expect(page.locator("#which")).to_have_text("3")
    page.locator("body").press("Tab")
    shelve = page.get_by_role("button", name="Shelve…")
    shelve.focus()
    page.keyboard.press("Tab")
    page.keyboard.press("Shift+Tab")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    before = store.events.range()[1]
    shelve.press("Enter")
    expect(page.locator("#dialog")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator("#dialog")).not_to_be_visible()
    assert store.events.range()[1] == before
    shelve.press("Enter")
    page.keyboard.type("Grace")
    page.keyboard.press("Tab")
    page.keyboard.type("spare joint comes on Tuesday")
    page.keyboard.press("Tab")
    page.keyboard.press("Control+a")
    page.keyboard.type("48")
    page.keyboard.press("Enter")
    expect(page.locator("#dialog")).not_to_be_visible()
    expect(page.locator("#active .alert")).to_contain_text("shelved by Grace")
    assert store.events.rows(after=before)[-1].document["shelved_why"] == "spare joint comes on Tuesday"


def test_an_alert_is_acknowledged_by_a_click_and_two_browsers_see_it(opened, served):
    """Without a name it is not sent; with one it is in the store, and on another's page without loading it anew."""
    _, _, store = served
    open_, _ = opened
    page, other = open_(), open_("phone", "dark")
    page.get_by_role("button", name="Acknowledge…").click()
    page.locator("#by").fill("")
    page.locator("#ok").click()
    expect(page.locator("#dialog")).to_be_visible()  # the browser itself asks for the name
    page.locator("#by").fill("Ada")
    page.locator("#reason").fill("<b>grease</b> is ordered")
    page.locator("#ok").click()
    for one in (page, other):
        expect(one.locator("#active .alert")).to_contain_text("acknowledged by Ada")
        expect(one.locator("#active .alert")).to_contain_text("<b>grease</b> is ordered")  # text, never markup
        expect(one.get_by_role("button", name="Acknowledge…")).to_have_count(0)
    assert store.events.rows(limit=1)[0].document["acknowledged_by"] == "Ada"


def test_a_refusal_is_told_in_the_dialog(opened):
    """A replay where motion is not allowed: the daemon's own words, and nothing closes."""
    open_, trouble = opened
    page = open_()
    page.locator("#replay").click()
    page.locator("#by").fill("Ada")
    page.locator("#ok").click()
    expect(page.locator("#problem")).to_contain_text("motion is not allowed")
    expect(page.locator("#dialog")).to_be_visible()
    trouble[:] = [told for told in trouble if "409" not in told]  # the browser notes every refusal


@pytest.mark.parametrize(
    ("size", "scheme"),
    [
        ("desktop", "light"),
        ("phone", "dark"),
        pytest.param("desktop", "dark", marks=pytest.mark.soak),
        pytest.param("phone", "light", marks=pytest.mark.soak),
    ],
)
def test_it_fits_and_can_be_read_in_every_size_and_scheme(opened, size, scheme):
    """Nothing sticks out sideways; text keeps a contrast of 4.5 to what is behind it; what is touched is 20 pixels high."""
    page = opened[0](size, scheme)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    weak = page.evaluate(
        """() => {
            const parse = (text) => (text.match(/[\\d.]+/g) || []).map(Number);
            const linear = (c) => (c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
            const light = ([r, g, b]) => [r, g, b].map((c) => linear(c / 255))
                .reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
            const behind = (one) => { for (; one; one = one.parentElement) {
                const c = parse(getComputedStyle(one).backgroundColor);
                if (c.length === 3 || c[3] > 0.99) return c; } return [255, 255, 255]; };
            const weak = [];
            for (const one of document.querySelectorAll("main *, header *")) {
                if (one.closest("svg, canvas, .uplot, [hidden]") || !one.offsetParent) continue;
                if (![...one.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())) continue;
                const a = light(parse(getComputedStyle(one).color)), b = light(behind(one));
                const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
                if (ratio < 4.5) weak.push(`${one.tagName} ${one.className} ${one.textContent.slice(0, 30)}: ${ratio.toFixed(2)}`);
            }
            return weak; }"""
    )
    assert not weak
    small = page.evaluate(
        "[...document.querySelectorAll('button, summary, #arm .joint')].filter((b) => b.getClientRects().length"
        " && b.getBoundingClientRect().height < 20).map((b) => b.outerHTML.slice(0, 80))"
    )
    assert not small


@pytest.mark.soak
def test_the_theme_button_is_remembered(opened):
    """Dark by a click on a light system, and still after loading anew."""
    page = opened[0]()
    light = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("#theme").click()
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert dark != light
    page.reload()
    expect(page.locator("#link")).to_have_text("live")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == dark


def test_a_new_monitor_asks_for_its_token_and_says_that_it_knows_nothing_yet(browser, tmp_path):
    """A wrong token is told; the right one opens the page, on which nothing looks good or bad before the first replay."""
    (tmp_path / "token").write_text("a token of this test")
    settings = configuration(tmp_path, token_file="token")
    with monitor(tmp_path, days=0, settings=settings, moving=False) as (server, _, _):
        page = browser.new_page()
        page.goto(server.url)
        expect(page.locator("#arm")).to_have_count(0)
        for token, told in (("wrong", True), ("a token of this test", False)):
            page.get_by_label("Token").fill(token)
            page.get_by_role("button", name="Sign in").click()
            expect(page.get_by_role("alert").filter(has_text="not the token")).to_have_count(int(told))
        expect(page.locator("#state")).to_contain_text("Not known yet")
        expect(page.locator("#active")).to_contain_text("Nothing can be said yet")
        expect(page.locator("#why")).to_have_text("No replay has been assessed yet.")
        expect(page.locator('#arm .joint[data-state="null"]')).to_have_count(6)
        expect(page.locator("#wear")).to_contain_text("No replay has been assessed yet")
        page.close()


def test_what_was_learnt_too_long_ago_is_marked_and_says_what_to_do(browser, tmp_path):
    """Three weeks without a replay: the state stays, and arm, every joint and the words say that it is of then."""
    with monitor(tmp_path, days=3, moving=False, later_days=21) as (server, _, _):
        page = browser.new_page()
        page.goto(server.url)
        expect(page.locator("#old")).to_be_visible()
        expect(page.locator("#stale")).to_contain_text("nothing was learnt for")
        expect(page.locator("#stale")).to_contain_text("ask for a replay")
        expect(page.locator("#arm .joint.stale")).to_have_count(6)
        expect(page.locator("#joints .old")).to_have_count(6)
        assert page.title().startswith("STALE")
        page.close()


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
    """A monitor without a past, and a page that looks at it on a phone; whatever is markup by mistake fails the test."""
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


def test_who_works_by_keyboard_stays_with_his_alert_however_many_there_are(blank):
    """Eight at once with words that never end: nothing sticks out, what waits comes first, every button says whose it is."""
    page, daemon, _ = blank
    for joint, condition, tier, more in MANY:
        where = "arm" if joint is None else f"j{joint}"
        daemon.bus.stream(f"alert/{where}/{condition}", "alert", {"joint": joint, "condition": condition, "tier": tier, **ALERT, **more})
    cards = page.locator("#active .alert")
    expect(cards).to_have_count(8)
    expect(page.locator("#count")).to_have_text("6")  # neither acknowledged nor shelved
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert cards.evaluate_all("all => all.map(one => one.dataset.key)") == [
        "2/sudden_step", "1/wear_rising", "3/friction_falling", "4/temperature_sensor", "5/wear_rising", "null/common_mode",
        "6/wear_rising", "6/data_quality",
    ]  # fmt: skip
    labels = page.locator("#active button").evaluate_all("all => all.map(one => one.getAttribute('aria-label') || one.textContent)")
    assert len({label for label in labels if "Look" not in label}) == sum("Look" not in label for label in labels) == 15
    expect(page.locator('[data-key="5/wear_rising"]')).to_have_attribute("data-state", "advice")  # its joint is NORMAL
    # a figure is a probability only where the condition has one
    assert "Probability" not in page.locator('[data-key="4/temperature_sensor"]').text_content()
    assert "has fallen" in page.locator('[data-key="3/friction_falling"]').text_content()
    page.locator('[data-key="4/temperature_sensor"] [data-do="ack"]').focus()
    before = cards.first.element_handle()
    daemon.bus.stream(
        "alert/j1/wear_rising", "alert", {"joint": 1, "condition": "wear_rising", "tier": "wear", **ALERT, "text": "said anew"}
    )
    expect(page.locator('[data-key="1/wear_rising"]')).to_contain_text("said anew")
    assert not before.evaluate("one => one.isConnected")  # all were made anew
    assert page.evaluate("document.activeElement.closest('.alert').dataset.key + document.activeElement.dataset.do") == (
        "4/temperature_sensorack"
    )
    # hours that were typed for a shelf keep no acknowledgement from being sent
    page.locator('[data-key="4/temperature_sensor"] [data-do="shelve"]').click()
    page.locator("#hours").fill("99999")
    page.keyboard.press("Escape")
    page.locator('[data-key="4/temperature_sensor"] [data-do="ack"]').click()
    page.locator("#by").fill("Ada")
    page.locator("#ok").click()
    expect(page.locator("#problem")).to_contain_text("no alert can be acknowledged")  # the daemon's own word: it was sent
    page.keyboard.press("Escape")
    assert page.evaluate("document.activeElement.closest('.alert').dataset.key") == "4/temperature_sensor"


def test_an_arm_that_is_not_heard_is_told_at_the_top_and_its_torque_is_not_now(blank):
    """Trouble comes and goes with the bus; an old sample is no present torque, whenever the page is opened."""
    page, daemon, store = blank
    trouble = {"name": "arm", "since": "2026-06-01T03:00:00Z", "text": "connection refused"}
    daemon.bus.stream("monitor", "monitor", {"troubles": [trouble]})
    expect(page.locator("#troubles")).to_contain_text("The arm is not heard since")
    expect(page.locator("#troubles")).to_contain_text("connection refused")
    daemon.bus.stream("monitor", "monitor", {"troubles": []})
    expect(page.locator("#troubles")).to_be_empty()
    sample = {name: [0.0] * 6 for name in ("q_rad", "predicted_nm", "std_nm", "measured_nm", "residual_nm", "extrapolated")}
    daemon.bus.stream("torque/live", "torque-live", {"at": rfc3339(FIRST_UNIX_S + DAY_S), **sample})
    expect(page.locator("#torque canvas")).to_be_visible()
    page.clock.fast_forward(16_000)
    expect(page.locator("#torque")).to_contain_text("Nothing is heard of the arm since")
    expect(page.locator("#residual")).to_be_empty()
    daemon.bus.stream("torque/live", "torque-live", {"at": rfc3339(FIRST_UNIX_S), **sample})
    store.stops.add("protective_stop", "safety mode 3", FIRST_UNIX_S)
    page.reload()
    expect(page.locator("#torque")).to_contain_text("Nothing is heard of the arm since")
    expect(page.locator("#troubles")).to_contain_text("Nothing moves until a person has looked at the arm")


def test_a_monitor_that_falls_silent_without_a_word_is_noticed_and_found_again(blank):
    """No end of the stream, no error, as when a telephone leaves the network: after 20 s nothing here claims to be of now."""
    page, _, _ = blank
    page.route("**/api/live", lambda route: route.abort())
    page.clock.fast_forward(21_000)
    expect(page.locator("#link")).to_have_text("not connected")
    expect(page.locator("#lost")).to_contain_text("all that stands here is of then")
    assert page.title().startswith("NOT CONNECTED")
    page.unroute("**/api/live")
    page.clock.fast_forward(21_000)
    expect(page.locator("#link")).to_have_text("live")
    expect(page.locator("#lost")).to_be_hidden()
