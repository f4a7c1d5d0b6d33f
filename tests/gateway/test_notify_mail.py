"""Mail to people, through a real SMTP server: each transition once, few messages, nothing lost in an outage."""

import email.utils
import re

import pytest
from mail_server import PASSWORD, USER, MailServer
from small_plant import DAY_S, NOW_UNIX_S, alert

from monitor.errors import StoreUnavailable
from monitor.gateway.outbox import Outbox
from monitor.gateway.settings import check_all
from monitor.gateway.status import gateway_status

HOUR_S = 3600.0


@pytest.fixture
def server(tmp_path):
    with MailServer(tmp_path) as made:
        yield made


def notify(server, *tables, **more):
    """The section [notify] with a table for each recipient."""
    lines = [f"{key} = {value}" for key, value in {"gather_s": 0, **more}.items()]
    head = f'[notify]\nsmtp = "127.0.0.1:{server.port}"\ntls = "none"\nsender = "Joint monitor <monitor@plant.example>"\n'
    return head + "\n".join(lines) + "\n" + "\n".join(f"[[notify.to]]\n{table}" for table in tables)


def to(name, more="", mail=None):
    return f'name = "{name}"\nmail = ["{mail or name}@plant.example"]\n{more}\n'


def test_a_wear_alert_is_one_mail_that_says_what_where_and_what_to_do(plant, server):
    """Subject, text, link and headers as a reader's own program reads them; the end of the alert is in the same thread."""
    plant.arm("hall/cell-1")
    with plant.gateway(
        '[gateway]\nlink = "https://plant.example/"\n' + notify(server, to("ada", 'time_zone = "Europe/Berlin"'))
    ) as running:
        plant.lives(running)
        raised = plant.now = plant.now + HOUR_S
        plant.happens("hall/cell-1", text="Elbow (joint 3): friction went from 10.26 to 11.19 N·m.")
        plant.lives(running, HOUR_S)
        plant.happens("hall/cell-1", "cleared", raised_unix_s=raised)
        plant.lives(running, HOUR_S)
    (_, first), (_, second) = server.taken
    assert first["Subject"] == "[wear] hall/cell-1: Elbow turns 9 % heavier than at the beginning."
    text = first.get_content()
    assert "friction went from 10.26 to 11.19 N·m" in text
    assert "Tier wear, raised, 2026-06-01 11:00 CEST." in text
    assert "To do: Plan an inspection of this joint." in text
    assert "https://plant.example/arms/hall/cell-1/" in text
    assert first["Auto-Submitted"] == "auto-generated"
    assert re.fullmatch(r"<alert\.\d+\.[0-9a-f]{24}@plant\.example>", first["Message-ID"])
    assert email.utils.parsedate_to_datetime(first["Date"]).timestamp() == raised
    assert second["Subject"].startswith("[over] hall/cell-1")
    assert first["References"] == second["References"]
    assert first["Message-ID"] != second["Message-ID"]


def test_an_alert_that_has_come_and_gone_before_its_mail_is_told_as_over(plant, server):
    """Nobody is sent to an arm for what is over: not by the subject, and not by something to do; what is not over comes first."""
    plant.arm("hall/cell-1")
    with plant.gateway(notify(server, to("ada"), gather_s=600)) as running:
        plant.lives(running)
        raised = plant.now = plant.now + HOUR_S
        plant.happens("hall/cell-1", tier="limit")
        plant.now += 60.0
        plant.happens("hall/cell-1", "cleared", tier="limit", raised_unix_s=raised)
        plant.lives(running, HOUR_S)
        raised = plant.now = plant.now + HOUR_S
        plant.happens("hall/cell-1", tier="limit")
        plant.happens("hall/cell-1", joint=2, tier="advisory")
        plant.now += 60.0
        plant.happens("hall/cell-1", "cleared", tier="limit", raised_unix_s=raised)
        plant.lives(running, HOUR_S)
    (_, first), (_, second) = server.taken
    assert first["Subject"] == "[over] hall/cell-1: Elbow turns 9 % heavier than at the beginning."
    assert "To do" not in first.get_content()
    assert second["Subject"].startswith("[notice] hall/cell-1: Shoulder")
    assert second["Subject"].endswith("(and 1 more)")
    assert second.get_content().count("To do") == 1


def test_a_day_s_outage_of_the_mail_server_loses_and_doubles_nothing(plant, server):
    """What came meanwhile is one message when it answers again; the status tells the trouble."""
    plant.arm("hall/cell-1")
    with plant.gateway(notify(server, to("ada"), to("bob"))) as running:
        plant.lives(running)
        server.stop()
        for joint in (1, 2, 3):
            plant.now += 7 * HOUR_S
            plant.happens("hall/cell-1", joint=joint, condition="wear_rising")
            plant.lives(running)
        assert "mail: mail server 127.0.0.1" in running.status()
        plant.now += 5 * HOUR_S
        plant.lives(running)
        server.start()
        plant.lives(running, HOUR_S)
        plant.lives(running, DAY_S, HOUR_S)
        assert "mail: 2 addresses, 0 deliveries wait" in running.status()
    assert sorted(recipients[0] for recipients, _ in server.taken) == ["ada@plant.example", "bob@plant.example"]
    for _, message in server.taken:
        assert [f"hall/cell-1: {joint} turns" in message.get_content() for joint in ("Base", "Shoulder", "Elbow")] == [True] * 3


def test_a_message_whose_answer_was_lost_comes_again_with_the_same_message_id(plant, server):
    """SMTP cannot say whether it was taken; mail servers and readers know a message by its id."""
    plant.arm("hall/cell-1")
    with plant.gateway(notify(server, to("ada"))) as running:
        plant.lives(running)
        plant.now += 60.0
        plant.happens("hall/cell-1")
        server.drops = 1
        plant.lives(running, HOUR_S)
    first, second = (message for _, message in server.taken)
    assert first["Message-ID"] == second["Message-ID"]
    assert first.as_bytes() == second.as_bytes()


def test_a_person_is_told_by_site_tier_condition_and_only_of_changes_of_tier(plant, server):
    """Routing; an update within a tier and an acknowledgement are no message; a shared address gets one."""
    for name in ("hall-1/a", "hall-2/b"):
        plant.arm(name)
    people = (
        to("one", 'sites = ["hall-1"]'),
        to("wear", 'tiers = ["wear", "limit"]'),
        to("again", 'tiers = ["wear"]', mail="wear"),
        to("step", 'conditions = ["sudden_*"]'),
        to("begins", 'cleared = false\nrobots = ["*/b"]'),
    )
    with plant.gateway(notify(server, *people)) as running:
        plant.lives(running)
        began = plant.now = plant.now + 60.0
        plant.happens("hall-1/a", tier="advisory")
        plant.lives(running, 60.0)
        plant.happens("hall-2/b", tier="wear", condition="sudden_step")
        plant.lives(running, 60.0)
        plant.happens("hall-2/b", "updated", tier="wear", condition="sudden_step", raised_unix_s=began)
        plant.happens("hall-2/b", "acknowledged", tier="wear", condition="sudden_step", raised_unix_s=began, by="ada")
        plant.happens("hall-2/b", "cleared", tier="wear", condition="sudden_step", raised_unix_s=began)
        plant.lives(running, HOUR_S)
    counts = {name: len(server.subjects(f"{name}@plant.example")) for name in ("one", "wear", "step", "begins")}
    assert counts == {"one": 1, "wear": 2, "step": 2, "begins": 1}


def test_quiet_hours_and_digest_hold_back_what_may_wait_and_the_limit_pierces(plant, server):
    """By the person's own clock: 2026-06-01 is a Monday, and 08:00 UTC is 10:00 in Berlin."""
    plant.arm("hall/cell-1")
    night = 'time_zone = "Europe/Berlin"\nquiet = "20:00-07:00"\nquiet_days = ["sat", "sun"]'
    with plant.gateway(notify(server, to("night", night), to("digest", 'digest_at = "06:00"'))) as running:
        plant.lives(running)
        plant.now = NOW_UNIX_S + 4 * DAY_S + 11 * HOUR_S  # Friday, 21:00 in Berlin
        plant.happens("hall/cell-1", tier="advisory")
        plant.happens("hall/cell-1", tier="wear", joint=2)
        plant.happens("hall/cell-1", tier="limit", joint=1)
        plant.lives(running, 600.0)
        assert len(server.subjects("night@plant.example")) == 1
        assert server.subjects("night@plant.example")[0].startswith("[limit] hall/cell-1: Base")
        plant.lives(running, 2 * DAY_S, HOUR_S)
        assert len(server.subjects("night@plant.example")) == 1
        plant.lives(running, 10 * HOUR_S, HOUR_S)  # Monday, 07:00 in Berlin is 05:00 UTC
        assert server.subjects("night@plant.example")[1:] == [
            "[wear] hall/cell-1: Shoulder turns 9 % heavier than at the beginning. (and 1 more)"
        ]
    at_once, digest = (message for recipients, message in server.taken if recipients == ["digest@plant.example"])
    assert "and 1 more" in at_once["Subject"]
    assert email.utils.parsedate_to_datetime(digest["Date"]).hour == 6


def test_a_cause_that_many_arms_share_is_one_message_a_day_that_lists_them(plant, server):
    """40 arms within three hours, and stragglers on the same day: two messages in two days, and none of the limit waits."""
    for k in range(40):
        plant.arm(f"hall/cell-{k}")
    with plant.gateway(notify(server, to("ada"), gather_s=600)) as running:
        plant.lives(running)
        plant.now += 60.0
        for k in range(36):
            plant.happens(f"hall/cell-{k}", joint=None, condition="common_mode", tier="advisory")
            plant.lives(running, 10.0, 10.0)
        plant.lives(running, 3 * HOUR_S, 300.0)
        assert len(server.taken) == 1
        assert server.subjects() == ["36 arms, one cause? common mode"]
        assert "hall/cell-35: " in server.taken[0][1].get_content()
        for k in range(36, 40):
            plant.happens(f"hall/cell-{k}", joint=None, condition="common_mode", tier="advisory")
            plant.lives(running, HOUR_S, 600.0)
        plant.happens("hall/cell-1", tier="limit")
        plant.lives(running, HOUR_S, 600.0)
        assert len(server.taken) == 2
        plant.lives(running, 2 * DAY_S, HOUR_S)
    assert server.subjects()[2:] == ["4 arms, one cause? common mode"]


def test_an_alert_that_nobody_acknowledges_is_escalated_once_and_one_that_somebody_did_is_not(plant, server):
    """After escalate_days of tier wear; a shelved one waits; taking an acknowledgement back counts from then on."""
    for k, more in enumerate(({}, {"acknowledged_at": "2026-06-01T09:00:00Z"}, {"shelved_until": "2026-06-08T08:00:00Z"})):
        plant.arm(f"hall/cell-{k}", health={"state": "MAINTENANCE_REQUIRED", "alerts": [alert(**more)]})
    with plant.gateway(notify(server, to("chief", "tiers = []\nescalation = true"), escalate_days=2)) as running:
        plant.lives(running)
        plant.now += 60.0
        for k in range(3):
            plant.happens(f"hall/cell-{k}")
        plant.lives(running, 2 * DAY_S - HOUR_S, HOUR_S)
        assert server.taken == []
        plant.lives(running, 3 * HOUR_S, HOUR_S)
        assert server.subjects() == ["Nobody has acknowledged: [wear] hall/cell-0: Elbow turns 9 % heavier than at the beginning."]
        plant.lives(running, 10 * DAY_S, 6 * HOUR_S)
    assert [subject.split("cell-")[1][0] for subject in server.subjects()] == ["0", "2"]


def test_the_weekly_report_comes_on_monday_with_the_printed_page(plant, server):
    """Of the arms that concern the reader, in his language; after an outage the newest one alone, and never one from before."""
    plant.arm("hall/cell-1", health={"state": "MAINTENANCE_REQUIRED", "alerts": [alert()], "since": "2026-06-03T10:00:00Z"})
    plant.arm("other/cell-2", health={"state": "NORMAL", "alerts": []})
    reader = to("ada", 'reports = ["weekly", "monthly"]\ntiers = []\nsites = ["hall"]\nlanguage = "de"\ntime_zone = "Europe/Berlin"')
    with plant.gateway(notify(server, reader)) as running:
        plant.lives(running, 3600.0)
        plant.now += 2 * DAY_S
        plant.happens("hall/cell-1")
        plant.lives(running, 5 * DAY_S, 6 * HOUR_S)
        assert server.subjects() == ["Wochenbericht, Arme: 1; 1 brauchen jemanden"]
        attached = next(iter(server.taken[0][1].iter_attachments()))
        assert attached.get_filename() == "joint-monitor-weekly-2026-06-08.html"
        page = attached.get_content()
        assert "hall/cell-1" in page
        assert "other/cell-2" not in page
        assert page.count("<tr>") == 2 + 2
        plant.now += 30 * DAY_S
        plant.lives(running, HOUR_S)
    assert len(server.taken) == 3


def test_a_report_that_could_not_be_owed_or_is_not_taken_comes_later_and_holds_up_no_alert(plant, server, monkeypatch):
    """The database is away at the very moment, then the server takes no page: what is grave comes through, and the report after it."""
    plant.arm("hall/cell-1", health={"state": "NORMAL", "alerts": []})
    with plant.gateway(notify(server, to("ada", 'reports = ["weekly"]'))) as running:
        plant.lives(running)
        plant.now += 7 * DAY_S
        with monkeypatch.context() as away:
            away.setattr(running.database, "write", _away)
            running.workers[0].once()
            assert "away" in running.workers[0].trouble
        server.poison = "joint-monitor-weekly"
        plant.lives(running, 120.0)
        assert [line.kind for line in gateway_status(plant.database, plant.now).owed] == ["report"]
        plant.happens("hall/cell-1", tier="limit")
        plant.lives(running, 120.0)
        assert [subject[:7] for subject in server.subjects()] == ["[limit]"]
        server.poison = None
        plant.lives(running, HOUR_S)
    assert [subject[:7] for subject in server.subjects()] == ["[limit]", "Weekly "]


def _away():
    raise StoreUnavailable("away")


def test_a_refused_recipient_holds_up_nobody_else_and_is_told(plant, server):
    """The other gets his mail at once; the refused one is tried again."""
    plant.arm("hall/cell-1")
    server.refused = {"gone@plant.example"}
    with plant.gateway(notify(server, to("gone"), to("ada"))) as running:
        plant.lives(running)
        plant.now += 60.0
        plant.happens("hall/cell-1")
        plant.lives(running, 600.0)
        assert len(server.subjects("ada@plant.example")) == 1
        owed = gateway_status(plant.database, plant.now).owed
        assert [line.recipient for line in owed] == ["gone@plant.example"]
        assert "550 5.1.1 nobody of this name" in owed[0].error
        server.refused = set()
        plant.lives(running, 2 * HOUR_S)
        assert len(server.subjects("gone@plant.example")) == 1


def test_a_message_that_the_server_does_not_survive_holds_up_no_other_one(plant, server):
    """The server hangs up at one of them; the others get through, and it is tried again later and later."""
    plant.arm("hall/cell-1")
    plant.arm("poison/cell-2")
    server.poison = "poison/cell-2"
    people = (to("both", 'sites = ["poison"]'), to("ada", 'sites = ["hall"]'))
    with plant.gateway(notify(server, *people)) as running:
        plant.lives(running)
        plant.now += 60.0
        plant.happens("poison/cell-2")
        plant.happens("hall/cell-1")
        plant.lives(running, 600.0)
        assert server.subjects() == ["[wear] hall/cell-1: Elbow turns 9 % heavier than at the beginning."]
        assert [line.attempts for line in gateway_status(plant.database, plant.now).owed] == [pytest.approx(5, abs=2)]


def test_a_message_that_cannot_be_made_holds_up_no_other_one(plant, server):
    """Of an arm whose clock is at the end of time, in a time zone where that is beyond it."""
    plant.arm("odd/cell-2")
    plant.arm("hall/cell-1")
    people = (to("both", 'sites = ["odd"]\ntime_zone = "Europe/Berlin"'), to("ada", 'sites = ["hall"]'))
    with plant.gateway(notify(server, *people)) as running:
        plant.lives(running)
        plant.now += 60.0
        plant.happens("odd/cell-2", at_unix_s=253_402_300_000.0)  # 9999-12-31T23:46:40Z
        plant.happens("hall/cell-1")
        plant.lives(running, 60.0)
        assert server.subjects() == ["[wear] hall/cell-1: Elbow turns 9 % heavier than at the beginning."]
        owed = gateway_status(plant.database, plant.now).owed
        assert [line.recipient for line in owed] == ["both@plant.example"]
        assert "a mistake of this program" in owed[0].error


def test_tls_and_password_are_used_and_the_check_says_how_far_it_gets(plant, tmp_path):
    """Each step that fails is named with what to do, and the password is in no text."""
    with MailServer(tmp_path, tls=True) as server:
        head = (
            f'[notify]\nsmtp = "127.0.0.1:{server.port}"\nsender = "monitor@plant.example"\nuser = "{USER}"\npassword = "credential:smtp"\n'
            f'gather_s = 0\nca_file = "{server.ca_file}"\n'
        )
        text = head + f"[[notify.to]]\n{to('ada')}"
        plant.arm("hall/cell-1")
        with plant.gateway(text, {"smtp": PASSWORD}) as running:
            assert PASSWORD not in repr(running.configuration)
            plant.lives(running)
            plant.now += 60.0
            plant.happens("hall/cell-1")
            plant.lives(running)
            assert len(server.taken) == 1
            server.refused = {"ada@plant.example"}
            steps = {each.step: (each.ok, each.text) for each in check_all(running.configuration)}
        assert {step: ok for step, (ok, _) in steps.items()} == {
            **{"name": True, "tcp": True, "tls": True, "authentication": True, "authorisation": False}
        }
        assert "550" in steps["authorisation"][1]
        with plant.gateway(text, {"smtp": PASSWORD[::-1]}) as running:
            plant.now += 60.0
            plant.happens("hall/cell-1", joint=1)
            plant.lives(running)
            found = check_all(running.configuration)
            assert (found[-1].step, found[-1].ok) == ("authentication", False)
            assert "user or password are refused: 535" in running.status()
            assert running.workers[0].next_try_unix_s - plant.now > 1700.0
            tried = server.logins
            plant.lives(running, HOUR_S)
            assert server.logins == tried  # an account that is tried again and again is locked
            assert PASSWORD[::-1] not in running.status() + str(found)
        with plant.gateway(text.replace(str(server.ca_file), ""), {"smtp": PASSWORD}) as running:
            found = check_all(running.configuration)
            assert (found[-1].step, found[-1].ok) == ("tls", False)
            assert "give the authority's certificate as ca_file" in found[-1].text
    with plant.gateway(text, {"smtp": PASSWORD}) as running:
        found = check_all(running.configuration)
    assert (found[-1].step, found[-1].ok) == ("tcp", False)
    assert Outbox(plant.database, plant.clock).owed("mail")[0].attempts == 0


def test_a_server_that_takes_no_password_and_one_without_tls_are_told_apart(plant, server):
    """The check names the step that it does not get through, and what to change."""
    account = 'user = "gateway"\npassword = "s3cret-word"\n[[notify.to]]'
    without_tls = notify(server, to("ada")).replace('tls = "none"', 'tls = "starttls"')
    for text, steps, why in (
        (
            notify(server, to("ada")).replace("[[notify.to]]", account),
            {"tls": True, "authentication": False},
            "takes no password on this port",
        ),
        (without_tls, {"tls": False}, "STARTTLS"),
    ):
        with plant.gateway(text) as running:
            found = check_all(running.configuration)
        assert {each.step: each.ok for each in found} == {"name": True, "tcp": True, **steps}
        assert why in found[-1].text


def test_a_message_about_very_many_arms_tells_of_each_of_them(plant, server):
    """The first ones in full, a line for each further one."""
    for k in range(120):
        plant.arm(f"hall/cell-{k:03d}")
    with plant.gateway(notify(server, to("ada"), fleet_arms=1000)) as running:
        plant.lives(running)
        plant.now += 60.0
        for k in range(120):
            plant.happens(f"hall/cell-{k:03d}")
        plant.lives(running)
    assert len(server.taken) == 1
    text = server.taken[0][1].get_content()
    assert [k for k in range(120) if f"hall/cell-{k:03d}: Elbow turns" not in text] == []
    assert text.count("To do:") == 50
