"""The page in a real Chromium: by mouse, by keyboard, on a phone, light and dark, without a network.

It is skipped where no Chromium or Playwright is installed.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from lived_monitor import configuration, monitor
from published import raw

from monitor.acquire.schedule.needed import UNTOLD
from monitor.identify.production.estimate import HARDLY_MOVED, IN_DAYS
from monitor.judge.document import plain
from monitor.judge.inspection import InspectionSettings
from monitor.judge.temperature.curves import Curve
from monitor.judge.temperature.laws import Line
from monitor.publish.compensation import compensation
from monitor.publish.documents import FromProduction, JointFromProduction, NextReplay, as_json, worded
from monitor.publish.timestamps import utc
from monitor.reason import joint_name, joints_by_number, reason_of
from monitor.service.lending import DueReplay

expect = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: the page is not tested in a browser").expect

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.timeout(240)]

# What comes late pushes down what stands below it, and a button that moves between press and release is not clicked.
STANDS = """() => {
    const all = [...document.querySelectorAll("button, table, canvas")].map((one) => one.getBoundingClientRect());
    const at = all.map((one) => [one.x, one.y, one.width]).join();
    window.standsFor = window.stoodAt === at ? window.standsFor + 1 : 0;
    window.stoodAt = at;
    return window.standsFor >= 5; }"""


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The page of an arm that moves, with forty days of history; its joint 3 wears."""
    with monitor(tmp_path_factory.mktemp("life"), days=40) as (server, daemon, store):
        yield server, daemon, store


@pytest.fixture
def opened(served, tabs):
    """Opens the page in a size and colour scheme. An error or warning of the browser, or a request to another host, fails the test."""
    server, _, _ = served
    trouble = []

    def open_(size="desktop", scheme="light", language="en"):
        page = tabs.open(size, scheme, {"en": "en-GB", "de": "de-DE"}[language], reduced_motion="reduce")
        page.set_default_timeout(20_000)
        # the test itself reads pixels; the browser warns that this is slow
        tabs.hear(
            page,
            "console",
            lambda message: (
                trouble.append(message.text) if message.type in {"error", "warning"} and "getImageData" not in message.text else None
            ),
        )
        tabs.hear(page, "pageerror", lambda error: trouble.append(str(error)))
        ours = (server.url, "data:")
        tabs.hear(page, "request", lambda request: None if request.url.startswith(ours) else trouble.append(request.url))
        page.goto(server.url)
        expect(page.locator("#link")).to_have_text({"en": "live", "de": "verbunden"}[language])
        expect(page.locator("#windows tbody tr").first).to_be_visible()
        expect(page.locator("#active .alert").first).to_be_visible()  # it chooses the joint that is shown first, and may come after them
        page.wait_for_function(STANDS, polling=100)
        return page

    yield open_, trouble
    assert not trouble


def test_the_state_of_the_arm_is_seen_at_once(opened):
    """The page shows the verdict, the alert with evidence, the wearing joint in drawing, table and tabs, its charts, and live torque."""
    page = opened[0]()
    expect(page.locator("#state")).to_contain_text("Maintenance required")
    expect(page.locator("#active .alert")).to_have_count(1)
    expect(page.locator("#active .alert")).to_contain_text("Elbow: Wear rising")
    expect(page.locator("#arm .joint")).to_have_count(6)
    expect(page.locator('#arm .joint[data-state="MAINTENANCE_REQUIRED"]')).to_have_count(1)
    expect(page.locator('#arm .joint[data-state="NORMAL"]')).to_have_count(5)
    expect(page.locator("#joints tbody tr")).to_have_count(6)
    expect(page.locator("#which")).to_have_text("Elbow")  # the joint in the worst state is shown first
    expect(page.locator("#old")).to_be_hidden()
    assert re.search(r"friction now 2\d\.\d % above.*; limit \d+ days after", page.locator("#wear").get_attribute("aria-label"))
    assert "% per kelvin" in page.locator("#law").get_attribute("aria-label")
    expect(page.locator("#torque canvas")).to_be_visible()
    assert page.title().startswith("Maintenance required: cell-1")
    expect(page.locator("#active h3")).to_have_text("Elbow turns 24 % heavier than on 1 June.")
    expect(page.locator("#active .text")).to_contain_text("At this pace it meets its limit around")
    expect(page.locator("#active .action")).to_contain_text("Inspect")
    expect(page.locator("#active .proof canvas")).to_be_visible()
    expect(page.locator("#why")).to_have_text("Elbow turns 24 % heavier than on 1 June.")
    expect(page.locator("#joints .sparkline polyline")).to_have_count(6)
    expect(page.locator("#active").get_by_text("went from")).to_be_hidden()
    page.locator("#active summary").click()
    expect(page.locator("#active").get_by_text("went from")).to_be_visible()
    expect(page.locator("#active .alert")).to_contain_text("of it temperature")


def test_torque_and_drawing_move_with_the_arm(opened):
    """The drawing and the torque change while one looks, and every chart has coloured pixels."""
    page = opened[0]()
    link, torque = page.locator("#arm .link").nth(2), page.locator("#torque")
    expect(torque).to_have_attribute("aria-label", re.compile("measured"))
    drawn, said = link.get_attribute("points"), torque.get_attribute("aria-label")
    expect(link).not_to_have_attribute("points", drawn)
    expect(torque).not_to_have_attribute("aria-label", said)
    for chart, colour in (("wear", "--line1"), ("law", "--line2"), ("torque", "--line1"), ("torque", "--line2")):
        page.wait_for_function(  # an empty chart has none, and a line of some seconds has some
            """([id, name]) => {
                const probe = document.createElement("i"); probe.style.color = `var(${name})`; document.body.append(probe);
                const want = getComputedStyle(probe).color.match(/\\d+/g).map(Number); probe.remove();
                const canvas = document.querySelector(`#${id} canvas`);
                const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
                let n = 0;
                for (let k = 0; k < data.length; k += 4) if (data[k + 3] > 200 && want.every((c, i) => Math.abs(c - data[k + i]) < 12)) n++;
                return n > 10; }""",
            arg=[chart, colour],
        )


def test_the_law_drawn_is_the_one_that_predicts_torque(opened):
    """A straight line, an exponential and Vogel's law are drawn as `Line.at` computes them, with 2σ to either side."""
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
        known = ~np.isnan(law)  # the line is drawn where friction was learnt, the band from 0 to 50 °C
        assert T[known].min() <= 8.0
        assert T[known].max() >= 42.0
        assert np.allclose(law[known], value[known])
        assert np.allclose(above, value + 2 * std)
        assert np.allclose(below, value - 2 * std)


@pytest.mark.parametrize(("apart_s", "says"), [(3600, ":"), (43200, ":"), (5 * 86400, "")])
def test_no_two_marks_along_the_time_read_alike(opened, apart_s, says):
    """Nine replays, an hour, half a day or five days after each other."""
    marks = opened[0]().evaluate(
        """async (apart) => {
            const charts = new Charts(), n = [...Array(9).keys()], of = (x) => n.map(() => x);
            const own = {
              wear: of(0), wear_std: of(0.1), replay_torque_nm: of(1), replay_torque_std_nm: of(0.1), reference_torque_nm: of(1) };
            charts.wear({ t: n.map((k) => 1.7e9 + apart * k) }, own, 3, [], null, 0.5);
            await new Promise(setTimeout);  // it is drawn after this turn
            return charts.plots.wear.axes[0]._values; }""",
        apart_s,
    )
    hours = [mark.split("\n")[0] for mark in marks]
    assert len(marks) > 2
    assert all(says in mark for mark in hours)
    assert sum("\n" in mark for mark in marks) < len(marks)  # a day is named once
    assert len(set(marks)) == len(marks) or apart_s == 43200  # noon and midnight come again, each day named


def test_choosing_a_joint_in_drawing_table_or_tabs_shows_it_everywhere(opened):
    """A click on any of the three chooses the joint."""
    page = opened[0]()
    for joint, where in ((5, "#arm .joint >> nth=4"), (2, "#joints tbody tr >> nth=1"), (6, "#tab-6")):
        page.locator(where).click()
        expect(page.locator("#which")).to_have_text(joint_name(joint))
        expect(page.locator(f"#tab-{joint}")).to_have_attribute("aria-selected", "true")
        expect(page.locator("#joints tr.on")).to_contain_text(f"J{joint}")
        assert f"{joint_name(joint)}:" in page.locator("#wear").get_attribute("aria-label")


def test_a_joint_that_a_person_chose_stays_chosen_when_the_states_come_later(served, tabs):
    """On a slow connection the drawing is there before the joints' states are; the worst joint is then shown only to who chose none."""
    server, _, _ = served
    page = tabs.open()
    held = []

    def hold(route):
        held.append(route)

    page.route("**/api/live*", hold)
    page.goto(server.url)
    page.locator("#tab-5").click()
    while not held:  # the test's own time limit ends it
        page.wait_for_timeout(50)
    held[0].continue_()
    expect(page.locator("#link")).to_have_text("live")
    expect(page.locator("#joints tbody tr").nth(2)).to_contain_text("Maintenance required")
    page.wait_for_timeout(300)  # the page looks ten times a second whether the states have come
    expect(page.locator("#which")).to_have_text(joint_name(5))
    page.unroute("**/api/live*")


def test_everything_can_be_done_by_keyboard(opened, served):
    """Arrows change tabs, Enter chooses a joint of the drawing, Tab, Escape and Enter work in the dialog; the focus is always visible."""
    _, _, store = served
    page = opened[0]()
    # Tab follows the order on the screen
    shown = "[...document.querySelectorAll('main > section')].filter((one) => one.getClientRects().length)"
    tops = page.evaluate(f"{shown}.map((one) => one.getBoundingClientRect().top)")
    assert tops == sorted(tops)
    page.locator("#tab-3").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#which")).to_have_text("Wrist 1")
    page.keyboard.press("End")
    expect(page.locator("#which")).to_have_text("Wrist 3")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#which")).to_have_text("Base")
    page.locator("#arm .joint").nth(2).focus()
    page.keyboard.press("Enter")
    expect(page.locator("#which")).to_have_text("Elbow")
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
    """Without a name it is not sent; with one it is stored, and another browser shows it without reloading."""
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


def test_a_refusal_is_shown_in_the_dialog(opened):
    """For a replay where motion is not allowed the dialog shows the daemon's text and stays open."""
    open_, trouble = opened
    page = open_()
    page.locator("#replay").click()
    page.locator("#by").fill("Ada")
    page.locator("#ok").click()
    expect(page.locator("#problem")).to_contain_text("motion is not allowed")
    expect(page.locator("#dialog")).to_be_visible()
    trouble[:] = [text for text in trouble if "409" not in text]  # the browser logs every refusal


@pytest.mark.parametrize(
    ("size", "scheme", "language"),
    [
        ("desktop", "light", "en"),
        ("phone", "dark", "de"),
        *(pytest.param(*other, marks=pytest.mark.soak) for other in (("desktop", "dark", "de"), ("phone", "light", "en"))),
    ],
)
def test_it_fits_and_can_be_read_in_every_size_and_scheme(opened, size, scheme, language):
    """Nothing is wider than the window, text has a contrast of 4.5 or more, and what one touches is 20 pixels high or more."""
    page = opened[0](size, scheme, language)
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


def test_the_joints_table_shows_the_remaining_life_at_every_width_in_german(opened):
    """The longest words: the last column of the table was cut at 1200 pixels."""
    page = opened[0]("desktop", "light", "de")
    cut = {}
    for width in (900, 1000, 1121, 1200, 1320, 1400):
        page.set_viewport_size({"width": width, "height": 900})
        cut[width] = page.evaluate(
            "(() => { const one = document.querySelector('#joints').parentElement; return one.scrollWidth - one.clientWidth })()"
        )
    assert not any(cut.values()), cut


@pytest.mark.soak
def test_the_theme_button_is_remembered(opened):
    """A click makes the page dark on a light system, and it stays dark after a reload."""
    page = opened[0]()
    light = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("#theme").click()
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert dark != light
    page.reload()
    expect(page.locator("#link")).to_have_text("live")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == dark


def test_a_new_monitor_asks_for_its_token_and_claims_nothing(tabs, tmp_path):
    """A wrong token is refused; the right one opens the page, which shows no state before the first replay."""
    (tmp_path / "token").write_text("a token of this test")
    settings = configuration(tmp_path, token_file="token")
    with monitor(tmp_path, days=0, settings=settings, moving=False) as (server, _, _):
        page = tabs.open()
        page.goto(server.url)
        expect(page.locator("#arm")).to_have_count(0)
        for token, refused in (("wrong", True), ("a token of this test", False)):
            page.get_by_label("Token").fill(token)
            page.get_by_role("button", name="Sign in").click()
            expect(page.get_by_role("alert").filter(has_text="not the token")).to_have_count(int(refused))
        expect(page.locator("#state")).to_contain_text("Not known yet")
        expect(page.locator("#active")).to_contain_text("Nothing can be said yet")
        expect(page.locator("#why")).to_have_text("No replay has been assessed yet.")
        expect(page.locator('#arm .joint[data-state="null"]')).to_have_count(6)
        expect(page.locator("#wear")).to_contain_text("No replay has been assessed yet")
        tabs.clear()


def test_an_old_verdict_is_marked_with_advice(tabs, tmp_path):
    """After three weeks without a replay the state stays, and the arm and every joint are marked STALE."""
    with monitor(tmp_path, days=3, moving=False, later_days=21) as (server, _, _):
        page = tabs.open()
        page.goto(server.url)
        expect(page.locator("#old")).to_be_visible()
        expect(page.locator("#stale")).to_contain_text("nothing was learnt for")
        expect(page.locator("#stale")).to_contain_text("ask for a replay")
        expect(page.locator("#arm .joint.stale")).to_have_count(6)
        expect(page.locator("#joints .old")).to_have_count(6)
        assert page.title().startswith("OUT OF DATE")
        tabs.clear()


ENGLISH_WORDS = re.compile(r"\b(the|of|is|are|and|not|were|with|since|from|this|that|has|been|by|until|no|nothing|joints?|replays?|wear)\b")
# names, and what other programs and people have said
FOREIGN = (
    "uPlot, MIT",
    "English",
    "the cell's door is open",
    "<b>grease</b> is ordered",
    "spare joint comes on Tuesday",
    "joint-monitor status",
    "joint-monitor",
)


def test_no_english_sentence_remains_in_the_german_page(opened):
    """Everything a person reads or hears of the page is German, but for names and what other programs have said."""
    page = opened[0](language="de")
    expect(page.locator("#active h3")).to_have_text("Ellbogen dreht 24\u00a0% schwerer als am 1. Juni.")
    for details in page.locator("details:not([hidden])").all():
        details.evaluate("one => one.open = true")
    texts = page.evaluate(
        """() => { const said = [];
            for (const one of document.querySelectorAll("body *:not(script):not(style)")) {
                for (const name of ["aria-label", "title", "placeholder"]) if (one.getAttribute(name)) said.push(one.getAttribute(name));
                for (const node of one.childNodes) if (node.nodeType === 3 && node.textContent.trim()) said.push(node.textContent.trim());
            }
            return [...said, document.title, document.documentElement.lang]; }"""
    )
    assert len(texts) > 150
    assert texts[-1] == "de"
    for foreign in FOREIGN:
        texts = [text.replace(foreign, "") for text in texts]
    assert [text for text in texts if ENGLISH_WORDS.search(text)] == []
    assert page.locator("#figures").get_by_text("+23,").count() == 1  # figures are German too


def test_the_dialogs_and_the_report_are_german_too(opened, served):
    """The dialog of every command and the printed report have no English word; the button to the report leads to it."""
    page = opened[0](language="de")
    commands = page.locator('#active button[data-do]:not([data-do="look"])')
    expect(commands).to_have_count(3)
    for command in commands.all():
        command.click()
        assert not ENGLISH_WORDS.search(page.locator("#dialog").inner_text())
        page.keyboard.press("Escape")
        expect(command).to_be_focused()  # which scrolls to it: a click elsewhere before that may miss
    with page.expect_popup() as opening:
        page.locator("#report-link").click()
    report = opening.value
    report.wait_for_load_state()  # all of it is read below, its drawings come last
    expect(report.locator("h1")).to_have_text("Bericht über den Reibungszustand")
    text = report.locator("body").inner_text()
    for foreign in FOREIGN:
        text = text.replace(foreign, "")
    assert ENGLISH_WORDS.findall(text) == []
    assert report.locator("svg").count() == 2
    csv = page.request.get(served[0].url + "history.csv")
    assert csv.headers["content-disposition"] == 'attachment; filename="hall-2-cell-1.csv"'
    assert csv.text().splitlines()[0].startswith("joint,")
    assert len(csv.text().splitlines()) == 38 * 6 + 1


def test_the_language_is_chosen_by_a_link_and_remembered(opened, served):
    """The link at the foot changes the language, and the page without its parameter comes in it again."""
    page = opened[0]()
    page.locator("#languages a").click()
    expect(page.locator("#alerts-h")).to_contain_text("Meldungen")
    page.goto(served[0].url)
    expect(page.locator("#alerts-h")).to_contain_text("Meldungen")


def test_a_replay_that_waits_for_the_programs_node_is_shown_with_what_kept_it_waiting(opened, served):
    """Due since, in both languages, as the daemon says it; then taken away again, and the next window of the clock stands there."""
    open_, _ = opened
    _, daemon, _ = served
    english, german = open_(), open_(language="de")
    passed_by = reason_of("payload: the controller reckons with 1.200 kg")
    due = DueReplay(key_unix_s=1.78e9, since_unix_s=1.78e9, until_unix_s=1.79e9, passed_by=passed_by)
    daemon.publisher.say(raw("monitor", {"troubles": [], "due": as_json(due.document())}))
    waits = "waiting for the program's node; at the last one: payload: the controller reckons with 1.200 kg"
    expect(english.locator("#due")).to_contain_text("due since ")
    expect(english.locator("#due")).to_contain_text(waits)
    expect(german.locator("#due")).to_contain_text("fällig seit ")
    expect(german.locator("#due")).to_contain_text("payload: the controller reckons with 1.200 kg")
    expect(german.locator("#due")).not_to_contain_text("waiting")
    daemon.publisher.say(raw("monitor", {"troubles": [], "due": None}))
    expect(english.locator("#due")).not_to_contain_text("due since")


def test_a_person_allows_motion_after_a_stop(tabs, tmp_path):
    """The stop is at the top and the headline is no green one; with a name and a reason motion is allowed, and both are kept."""
    with monitor(tmp_path, days=3, moving=False, before=lambda store: store.stops.add("protective_stop", "safety mode 3", 0.0)) as (
        server,
        _,
        store,
    ):
        page = tabs.open()
        page.goto(server.url)
        expect(page.locator("#troubles")).to_contain_text("Nothing moves until a person has looked at the arm and allows it")
        expect(page.locator("#verdict")).to_have_attribute("data-state", "CHECK_FUNCTION")
        page.locator("#allow").click()
        page.locator("#by").fill("Ada")
        page.locator("#ok").click()
        expect(page.locator("#dialog")).to_be_visible()  # a reason is asked for
        page.locator("#reason").fill("a box stood in the way")
        page.locator("#ok").click()
        expect(page.locator("#dialog")).not_to_be_visible()
        expect(page.locator("#troubles")).to_be_empty()
        expect(page.locator("#verdict")).to_have_attribute("data-state", "NORMAL")
        assert not store.stops.waiting()
        assert [(stop.allowed_by, stop.allowed_why) for stop in store.stops.rows()] == [("Ada", "a box stood in the way")]
        tabs.clear()


def test_production_on_a_joint_is_declared_on_the_page(tabs, tmp_path):
    """A replaced joint begins anew: its alert clears, the dialog says so, the chart has a mark; and a mistake is taken back there."""
    with monitor(tmp_path, days=32, moving=False) as (server, _, store):
        page = tabs.open(locale="en-US")
        page.goto(server.url)
        page.locator('#active [data-do="serviced"]').click()
        page.locator("#kind").select_option("replaced")
        page.locator("#by").fill("Ada")
        page.locator("#reason").fill("spare part 7")
        page.locator("#ok").click()
        expect(page.locator("#dialog-text")).to_contain_text("It is a new joint")
        expect(page.locator("#fields")).to_be_hidden()
        page.locator("#cancel").click()
        expect(page.locator("#active")).to_contain_text("No active alert")
        page.locator("#past summary").first.click()
        expect(page.locator("#cleared h3")).to_contain_text("Elbow turns")
        expect(page.locator("#cleared")).to_contain_text("serviced: Elbow (joint 3) was replaced")
        (production,) = store.maintenance.rows()
        assert production.document["kind"] == "replaced"
        page.locator("#tab-3").click()
        expect(page.locator("#wear")).to_have_attribute("aria-label", re.compile("; replaced on Jul 3$"))
        expect(page.locator("#worked")).to_contain_text("Elbow (joint 3) was replaced")
        page.locator("#undo").click()
        page.locator("#reason").fill("it was the shoulder")
        page.locator("#ok").click()
        expect(page.locator("#dialog-text")).to_contain_text("What is known of Elbow (joint 3) is what it was before")
        page.locator("#cancel").click()
        expect(page.locator("#worked")).to_be_empty()
        expect(page.locator("#active h3")).to_contain_text("Elbow turns")  # the alert is back
        (undone,) = store.maintenance.rows()
        assert (undone.undone_by, undone.undone_why) == ("Ada", "it was the shoulder")
        tabs.clear()


def test_a_dark_page_is_printed_on_white(opened):
    """Printing paints page and charts light, and the screen is dark again afterwards."""
    page = opened[0]("desktop", "dark")
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(243, 245, 248)"
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == dark


def test_a_joint_says_what_came_from_production_and_how_far_the_next_replay_is(opened, served):
    """Observations by replays and by work, what work holds of what is needed, and the next replay with its reason: in German."""
    _, daemon, store = served
    at = store.assessments.state().belief["at_unix_s"]
    joint = {"known": False, "share": 0.02, "learnt_from_replays": 40, "learnt_from_production": 3, "learnt_at": utc(at)}
    reason = worded(reason=HARDLY_MOVED(joint=3, moving_s=0.0, during=IN_DAYS(days=7.0)))
    why = worded(why=UNTOLD(joints=joints_by_number([3]), days=7.0))
    document = FromProduction(
        period_began_at=utc(at),
        period_ended_at=utc(at),
        observations=3,
        seen_s=3600.0,
        left_out_s={},
        asks=[],
        next_replay=NextReplay(replay="when_needed", needed_from=utc(at + 9 * 86_400.0), **why),
        joints=[JointFromProduction(joint=j, **joint, **reason) for j in range(1, 7)],
    )
    page = opened[0](language="de")
    daemon.publisher.say(document)
    figures = page.locator("#figures")
    expect(figures).to_contain_text("40 Prüffahrten, 3 Zeiträumen Arbeit")
    expect(figures).to_contain_text("0,02 (Ellbogen (Gelenk 3): in 7 Tagen hat es sich 0 s bewegt; eine Prüffahrt ist nötig)")
    expect(figures).to_contain_text("die normale Arbeit sagt nicht genug über Gelenk 3: nach 7 Tagen ist eine Prüffahrt nötig")
    assert not ENGLISH_WORDS.search(figures.inner_text())


def test_a_joint_says_which_temperatures_are_known_and_which_are_missing(opened, served):
    """By the document `compensation`; the chart of its law reaches over the whole working range."""
    known = compensation(served[1].state.torque_model, served[1].state.estimator.belief).joints[0].by_temperature
    inside = [f"{row.temperature_c:.0f}" for row in known if not row.extrapolated]
    page = opened[0]()
    page.locator("#tab-1").click()
    page.locator("details.physics summary").click()
    expect(page.locator("#physics")).to_contain_text(f"Temperatures known{inside[0]}–{inside[-1]} °C" if inside else "Temperatures known–")
    expect(page.locator("#physics")).to_contain_text("Temperatures missing, of 0 to 50 °C")
    assert page.evaluate("charts.plots.law.scales.x.min") <= 0.0
    assert page.evaluate("charts.plots.law.scales.x.max") >= 50.0


def test_checks_hours_and_stops_are_shown_and_a_check_is_recorded_by_a_click(opened, served):
    """Hidden until [inspection] asks for it; then in German too, and whoever clicks is kept with what was found."""
    _, daemon, store = served
    page = opened[0](language="de")
    expect(page.locator("#inspection")).to_be_hidden()
    settings = InspectionSettings(plan="universal-robots", hours_before=5200.0)
    daemon.state.use(replace(daemon.state.configuration, inspection=settings))
    at = store.assessments.state().belief["at_unix_s"]
    store.duties.stop_began(at, int(at // 86_400.0), "protective_stop", during_replay=False)
    store.duties.stop_explained(1, 3, "C153A2")
    daemon.publisher.inspection()
    expect(page.locator("#duty")).to_contain_text("5200,0 h")
    expect(page.locator("#checks tbody tr")).to_have_count(8)
    row = page.locator("#checks tbody tr").nth(2)
    expect(row).to_contain_text("Flachringe")
    expect(row).to_contain_text("fällig, nie eingetragen")
    page.locator("#stops-kept summary").click()
    expect(page.locator("#safety-stops")).to_contain_text("Schutzstopp")
    expect(page.locator("#safety-stops")).to_contain_text("Ellbogen")
    assert not ENGLISH_WORDS.search(page.locator("#checks").inner_text())
    row.locator("button").click()
    page.locator("#by").fill("Ada")
    page.locator("#reason").fill("wie neu")
    page.locator("#ok").click()
    expect(row).to_contain_text("noch nicht fällig")
    expect(row).to_contain_text("Ada")
    (made,) = store.duties.inspections()
    assert (made.item, made.done_by, made.why) == ("flat rings", "Ada", "wie neu")
