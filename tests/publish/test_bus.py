"""Real Zenoh sessions on loopback: publication, last values, queries and their errors."""

import json
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
import zenoh
from published import raw

from monitor.errors import BadConfiguration, BadInput, BusError
from monitor.publish.bus import Bus, QueryHandler
from monitor.publish.client import Client
from monitor.publish.session import BusSettings, prefix, session_config


def double(request):
    if "x" not in request:
        raise BadInput("double: x is missing")
    if request["x"] == "boom":
        raise RuntimeError("ours")
    return raw("torque", {"torque_nm": [2 * request["x"]]})


@pytest.fixture
def bus(free_port: int) -> Iterator[tuple[Bus, str]]:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with Bus(
        BusSettings(listen=(endpoint,)),
        prefix("lab", "cell-1"),
        {"torque": QueryHandler("torque", double), "history": QueryHandler("history", lambda given: raw("history", given), payload=False)},
    ) as bus:
        yield bus, endpoint


def test_a_client_that_connects_late_gets_the_last_values(bus):
    """`get` returns what was published before, with the encoding that names its kind."""
    bus, endpoint = bus
    bus.say(raw("health", {"state": "NORMAL"}))
    bus.say(raw("friction", {"joint": 3, "coulomb_nm": 1.0}))
    bus.say(raw("friction", {"joint": 3, "coulomb_nm": 2.0}))
    with Client(endpoint, "lab", "cell-1") as client:
        assert [message.document["state"] for message in client.get("health")] == ["NORMAL"]
        assert {message.key: message.document["coulomb_nm"] for message in client.get("joint/*/friction")} == {"joint/3/friction": 2.0}
        assert {message.key for message in client.get("**")} == {"health", "joint/3/friction"}


def test_any_plain_zenoh_client_can_subscribe_and_query(bus):
    """The client uses only plain zenoh, JSON and the documented keys."""
    bus, endpoint = bus
    with zenoh.open(session_config(mode="client", connect=(endpoint,))) as session:
        heard: list[zenoh.Sample] = []
        session.declare_subscriber("joint-monitor/v1/**", heard.append)
        _until(
            lambda: heard, meanwhile=lambda: bus.say(raw("alert", {"joint": 3, "condition": "wear_rising"}))
        )  # once the publisher knows it
        sample = heard[0]
        assert str(sample.key_expr) == "joint-monitor/v1/lab/cell-1/alert/j3/wear_rising"
        assert json.loads(sample.payload.to_bytes())["joint"] == 3
        assert str(sample.encoding) == "application/json;joint-monitor.alert.v1"
        (reply,) = list(session.get("joint-monitor/v1/lab/cell-1/torque", payload=b'{"x": 21}', timeout=5.0))
        assert json.loads(reply.ok.payload.to_bytes())["torque_nm"] == [42]


def test_a_malformed_query_gets_an_error_that_names_the_mistake(bus):
    """No payload, no JSON, no object, a missing argument: each gets its error at once, and no time-out."""
    _, endpoint = bus
    with zenoh.open(session_config(mode="client", connect=(endpoint,))) as session:
        for payload, says in (
            (None, "no payload"),
            (b"{", "not JSON"),
            (b"[1]", "the payload is an array; expected a JSON object"),
            (b"null", "the payload is null; expected a JSON object"),
            (b'"j3"', "the payload is a string; expected a JSON object"),
            (b"{}", "x is missing"),
            (b"[" * 100_000, "not JSON"),
            (b'{"x": NaN}', "not JSON"),
        ):
            began = time.monotonic()
            (reply,) = list(session.get("joint-monitor/v1/lab/cell-1/torque", payload=payload, timeout=5.0))
            assert says in json.loads(reply.err.payload.to_bytes())["error"]
            assert time.monotonic() - began < 4.0  # answered, not timed out


def test_an_exception_in_an_answer_gives_an_error_and_the_next_query_productions(bus):
    """After an exception in an answer, the client does not wait and the queryable still answers."""
    _, endpoint = bus
    with Client(endpoint, "lab", "cell-1") as client:
        with pytest.raises(BadInput, match="internal: RuntimeError"):
            client.get("torque", {"x": "boom"})
        assert client.get("torque", {"x": 1})[0].document["torque_nm"] == [2]


def test_a_wildcard_query_runs_no_command(bus):
    """`get **` with a payload reads last values and never calls an answering function."""
    bus, endpoint = bus
    bus.say(raw("health", {"state": "NORMAL"}))
    with Client(endpoint, "lab", "cell-1") as client:
        assert [message.key for message in client.get("**", {"x": 1})] == ["health"]


def test_a_query_without_a_payload_may_have_parameters(bus):
    """`history?a=1;b=2` gives the answering function an object of strings. Too long parameters are refused."""
    _, endpoint = bus
    with Client(endpoint, "lab", "cell-1") as client:
        assert {"a": "1", "b": "2"}.items() <= client.get("history?a=1;b=2")[0].document.items()
        with pytest.raises(BadInput, match="at most 1000"):
            client.get("history?a=" + "x" * 1000)


def test_a_watcher_gets_last_values_first_and_then_new_messages(bus):
    """Order per key is kept and `until` ends the watch."""
    bus, endpoint = bus
    bus.say(raw("health", {"n": 0}))
    seen: list[int] = []

    def say() -> None:
        _until(lambda: seen)  # the watcher has the last value; it subscribed before it asked for that
        for n in range(1, 4):
            bus.say(raw("health", {"n": n}))

    speaker = threading.Thread(target=say)
    speaker.start()
    with Client(endpoint, "lab", "cell-1") as client:
        for message in client.watch("health", until=lambda: len(seen) >= 4):
            seen.append(message.document["n"])
    speaker.join()
    assert seen == [0, 1, 2, 3]


def test_done_is_called_after_the_document_is_sent(bus):
    """The store marks an event as published only after the bus took it."""
    bus, _ = bus
    sent = threading.Event()
    bus.say(raw("event", {"kind": "raised"}), done=sent.set)
    assert sent.wait(5.0)


def test_an_endpoint_without_a_daemon_is_reported_in_time(free_port: int):
    """A client without a daemon gets a message with the endpoint."""
    with pytest.raises(BusError, match=f"127.0.0.1:{free_port}"):
        Client(f"tcp/127.0.0.1:{free_port}", "lab", "cell-1", timeout_s=1.0)


def test_an_endpoint_in_use_is_refused_with_its_name(bus):
    """The second daemon on one endpoint gets a message with the endpoint."""
    _, endpoint = bus
    with pytest.raises(BadConfiguration, match=endpoint.removeprefix("tcp/")):
        Bus(BusSettings(listen=(endpoint,)), prefix("lab", "cell-2"))


@pytest.mark.parametrize("site", ["Lab", "a/b", "", "a*", "ä"])
def test_an_id_with_characters_that_no_key_allows_is_refused(site: str):
    """Only a–z, 0–9, _ and - may become part of a key."""
    with pytest.raises(BadInput, match="expected only"):
        prefix(site, "cell-1")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"listen": ("a",)}, "listen: 'a' is no endpoint; expected PROTOCOL/ADDRESS"),
        ({"connect": ("127.0.0.1:7447",)}, "connect: '127.0.0.1:7447' is no endpoint"),
        ({"listen": ("tcp/",)}, "is no endpoint"),
        ({"listen": (), "connect": ()}, "nobody could hear"),
        ({"live_rate_hz": 0.0}, "live_rate_hz = 0.0; expected 0.1 to 125"),
        ({"health_period_s": 1e9}, "health_period_s = 1000000000.0; expected 1 to 3600"),
        ({"query_workers": 0}, "query_workers = 0; expected 1 to 32"),
    ],
)
def test_impossible_session_settings_are_refused(changes: dict, says: str):
    """The message names the setting, before a session is opened."""
    with pytest.raises(BadInput, match=re.escape(says)):
        BusSettings(**changes)


@pytest.mark.parametrize("selector", ["t*", "", "joint//friction", "health/", "#"])
def test_an_invalid_key_expression_is_refused_by_the_client(bus, selector):
    """The message has Zenoh's reason and an example, for a get and for a watcher."""
    with Client(bus[1], "lab", "cell-1") as client:
        for ask in (client.get, lambda selector: next(client.watch(selector))):
            with pytest.raises(BadInput, match="is no key expression"):
                ask(selector)


def test_a_missing_router_is_reported_and_joined_when_it_starts(free_port: int):
    """Without the router, clients of the daemon's own endpoint are answered. If none is configured, none is reported as missing."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with Bus(BusSettings(listen=(), connect=(endpoint,)), prefix("lab", "cell-1")) as bus:
        assert endpoint in (bus.without_router() or "")
        with zenoh.open(session_config(mode="router", listen=(endpoint,))):
            deadline = time.monotonic() + 20.0
            while bus.without_router() is not None and time.monotonic() < deadline:
                time.sleep(0.05)
            assert bus.without_router() is None
    with Bus(BusSettings(listen=(endpoint,)), prefix("lab", "cell-1")) as bus:
        assert bus.without_router() is None


def test_a_missing_router_is_told_in_our_words_alone(tmp_path, free_port):
    """Zenoh's own warnings of its start stay out of the log: the problem `router` says it once."""
    code = (
        "import sys; from monitor.publish.bus import Bus; from monitor.publish.session import BusSettings, log_refusals\n"
        "settings = BusSettings(listen=(), connect=(sys.argv[1],)); log_refusals(settings)\n"
        "with Bus(settings, 'joint-monitor/v1/lab/a') as bus: print(bus.without_router())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, f"tcp/127.0.0.1:{free_port}"], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stderr == ""
    (line,) = done.stdout.splitlines()
    assert line.startswith(f"nobody answers at tcp/127.0.0.1:{free_port}")


def test_a_watcher_is_told_when_the_monitor_is_gone_and_when_it_is_back(free_port):
    """By the liveliness token, whatever it watches: nothing else would come from a dead monitor."""
    endpoint, told = f"tcp/127.0.0.1:{free_port}", []
    with Bus(BusSettings(listen=(endpoint,)), "joint-monitor/v1/lab/cell-1") as first, Client(endpoint, "lab", "cell-1") as client:
        done = threading.Event()
        watches = threading.Event()  # what `until` is asked for, once everything is subscribed to

        def watch() -> None:
            for _ in client.watch("alert/**", until=lambda: watches.set() or done.is_set(), alive=told.append):
                pass

        watching = threading.Thread(target=watch)
        watching.start()
        try:
            assert watches.wait(20.0)
            first.close()
            _until(lambda: told[-1:] == [False])
            with Bus(BusSettings(listen=(endpoint,)), "joint-monitor/v1/lab/cell-1"):
                _until(lambda: told[-1:] == [True])
        finally:
            done.set()
            watching.join()


def _until(holds, within_s: float = 20.0, *, meanwhile=lambda: None) -> None:
    deadline = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < deadline
        meanwhile()
        time.sleep(0.05)
