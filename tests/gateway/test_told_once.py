"""What nobody else can say: alerts from before there was a gateway, and the silence of the plant's own service. Each is told once."""

import pytest
from mail_server import MailServer
from small_plant import DAY_S, NOW_UNIX_S, alert
from test_notify_mail import notify, to
from test_tickets import CREDENTIALS, Maintenance, tickets

from monitor.gateway.run import Gateway
from monitor.gateway.settings import load_gateway
from monitor.gateway.silence import PlantWatch
from monitor.gateway.status import gateway_status
from monitor.plant.ingest import RUNNING, set_note
from monitor.publish.timestamps import rfc3339

HOUR_S, LONG_AGO_UNIX_S = 3600.0, NOW_UNIX_S - 90 * DAY_S


@pytest.fixture
def server(tmp_path):
    with MailServer(tmp_path) as made:
        yield made


def old(joint=3, tier="wear", **more):
    return alert(joint, tier=tier, raised_unix_s=LONG_AGO_UNIX_S, **more)


def says(plant, name, *alerts):
    plant.now += 1.0
    return plant.arm(name, health={"state": "MAINTENANCE_REQUIRED", "alerts": list(alerts)})


def again(plant):
    """The gateway is started anew with the file of before."""
    folder = plant.path.parent
    return Gateway(load_gateway(folder / "plant.toml", {"CREDENTIALS_DIRECTORY": str(folder / "credentials")}), now=plant.clock)


def test_what_was_active_before_the_gateway_first_ran_is_one_mail_and_a_ticket_each(plant, server):
    """Also of three arms with one condition, of an arm that joins later, and after restarts; not what a person knows of already."""
    says(plant, "hall/cell-1", old(text="This one turns heavier."))
    says(plant, "hall/cell-2", old(2, "limit"), old(1, "advisory"))
    says(plant, "hall/cell-3", old(acknowledged_at=rfc3339(NOW_UNIX_S - DAY_S)), old(4, shelved_until=rfc3339(NOW_UNIX_S + DAY_S)), old(5))
    with Maintenance() as orders:
        people = notify(server, to("ada"), to("chief", 'tiers = ["limit"]'), to("bob", 'quiet = "07:00-10:00"'))
        with plant.gateway(tickets(orders) + people, CREDENTIALS) as running:
            plant.lives(running, HOUR_S)
            assert sorted(server.subjects("ada@plant.example") + server.subjects("chief@plant.example")) == [
                "Active already: [limit] hall/cell-2: Shoulder turns 9 % heavier than at the beginning.",
                "Active already: [limit] hall/cell-2: Shoulder turns 9 % heavier than at the beginning. (and 3 more)",
            ]
            text = server.taken[0][1].get_content()
            assert text.startswith("This was raised before anybody could be told, and nobody has acknowledged it.")
            assert "Tier limit, active already, 2026-03-03 08:00 UTC." in text
            assert sorted(each["priority"] for each in orders.tickets.values()) == ["high", "medium", "medium"]
        for _ in range(2):
            with again(plant) as running:
                plant.lives(running, 2 * HOUR_S, 600.0)
        assert len(server.subjects("bob@plant.example")) == 1
        with again(plant) as running:
            says(plant, "hall/cell-9", old(6))
            plant.lives(running, HOUR_S)
            assert server.subjects("ada@plant.example")[1:] == [
                "Active already: [wear] hall/cell-9: Wrist 3 turns 9 % heavier than at the beginning."
            ]
            plant.happens("hall/cell-1", "cleared", raised_unix_s=LONG_AGO_UNIX_S)
            plant.lives(running, HOUR_S)
        assert server.subjects("ada@plant.example")[2].startswith("[over] hall/cell-1")
        assert sorted(str(each.get("status")) for each in orders.tickets.values()) == ["None", "None", "None", "closed"]


@pytest.mark.parametrize("health_first", [True, False])
def test_an_old_replay_that_is_judged_after_the_gateway_s_start_is_told_once(plant, server, health_first):
    """Its alert began before, and the arm raises it now: whichever the gateway sees first, health or transition, is told."""
    plant.arm("hall/cell-1")
    with plant.gateway(notify(server, to("ada"))) as running:
        plant.lives(running)
        plant.now += HOUR_S
        for health in (health_first, not health_first):
            if health:
                says(plant, "hall/cell-1", old())
            else:
                plant.happens("hall/cell-1", raised_unix_s=LONG_AGO_UNIX_S)
            plant.lives(running, HOUR_S)
    assert len(server.taken) == 1


def test_whoever_wants_to_hear_of_changes_alone_turns_that_off(plant, server):
    """[gateway] already_active."""
    says(plant, "hall/cell-1", old(), {"raised_at": "nonsense", "active": True}, old(joint="x"), old(tier="grave"))
    with plant.gateway("[gateway]\nalready_active = false\n" + notify(server, to("ada"))) as running:
        plant.lives(running, HOUR_S, 600.0)
        assert server.taken == []
    with plant.gateway(notify(server, to("ada"))) as running:
        plant.lives(running, HOUR_S, 600.0)
    assert len(server.taken) == 1


def test_a_plant_whose_service_stops_is_told_once_and_so_is_its_return(plant, server):
    """By its word, which changes every few seconds: its clock may be wrong, and a restart of the gateway or an outage is no silence."""
    plant.arm("hall/cell-1")

    def lives(running, minutes, *, word=None):
        for minute in range(minutes):
            if word is not None:
                set_note(plant.database, RUNNING, word + minute, {})
            plant.lives(running, 60.0)

    people = notify(server, to("ada", 'sites = ["elsewhere"]'), to("chief", 'tiers = ["limit"]'))
    with plant.gateway('[gateway]\nlink = "https://plant.example"\n' + people) as running:
        lives(running, 20)  # it has never run
        lives(running, 20, word=NOW_UNIX_S - DAY_S)
        lives(running, 12)
        running._plant_watch.rest()  # as after an outage of the database
        lives(running, 12)
        assert server.taken == []
        lives(running, 30)
    for _ in range(2):
        with again(plant) as running:
            lives(running, 30)
    assert server.subjects() == ["[notice] plant/service: The plant's service does not run."]
    text = server.taken[0][1].get_content()
    assert "To do: Look at the service joint-monitor-plant: until it runs" in text
    assert text.splitlines()[-1] == "https://plant.example/"
    assert gateway_status(plant.database, plant.now).owed == []  # that it is told is owed to nobody
    with again(plant) as running:
        lives(running, 20, word=NOW_UNIX_S)
    assert server.subjects()[1:] == ["[over] plant/service: The plant's service runs again."]


@pytest.mark.parametrize("jump_s", [HOUR_S, -DAY_S])
def test_a_computer_that_slept_and_a_clock_that_is_set_are_no_silence_of_the_plant(jump_s):
    """Both services wake up together, and the plant's word is a moment away; from then on a silence counts as ever."""
    watch = PlantWatch(900.0)
    woke_unix_s = NOW_UNIX_S + jump_s
    assert watch.look(1.0, (), NOW_UNIX_S) == watch.look(1.0, (), woke_unix_s) == []
    looks = [len(watch.look(1.0, (), woke_unix_s + 60.0 * minute)) for minute in range(1, 16)]
    assert looks == 14 * [0] + [1]


def test_a_ticket_about_the_plant_s_service_links_to_the_plant_s_page(plant):
    """There is no arm whose page could be shown."""
    with Maintenance() as orders:
        text = tickets(orders, 'tiers = ["advisory"]\n[tickets.fields]\nreference = "{key}"\nlink = "{link}"\n')
        with plant.gateway(text, CREDENTIALS) as running:
            set_note(plant.database, RUNNING, plant.now, {})
            plant.lives(running, HOUR_S, 600.0)
        assert [each["link"] for each in orders.tickets.values()] == ["https://plant.example/"]
