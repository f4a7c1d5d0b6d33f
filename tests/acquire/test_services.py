"""Every port that a motion needs is tried by `check`, and the pendant's menu is named; nothing starts on the controller."""

import pytest
from excitations import short
from sim_process import eventually
from simulated_arm import known_gains, simulated_arm

from monitor.acquire.replay import check
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.driver import UniversalRobots
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.simulate.remote import Remote

API_PORT = 18083
CB3 = ("ur5", "127.0.6.40", (), "Dashboard Server (29999)")
X = ("ur5e", "127.0.6.41", ("--polyscope", "10.12.1", "--robot-api-port", str(API_PORT)), f"Robot API ({API_PORT})")


def found(model: str, host: str):
    """The conditions by name."""
    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False)
    driver = UniversalRobots(robot_api_port=API_PORT)
    results = check(settings, short(robot=model), load_robot(model), Context(), installation=known_gains(model), driver=driver)
    return {each.name: each for each in results}


@pytest.mark.parametrize(("model", "host", "options", "stops"), [CB3, X], ids=["cb3", "x"])
def test_a_closed_port_is_named_with_the_menu_that_opens_it(model: str, host: str, options: tuple[str, ...], stops: str):
    """One at a time, on both kinds of controllers; with all of them open the condition holds, and no program was sent."""
    with simulated_arm(host, "--robot", model, *options), Remote(host) as remote:
        assert found(model, host)["services"].holds
        assert stops in found(model, host)["services"].text
        for service, name in (
            ("primary", "Primary Client Interface (30001)"),
            ("realtime", "Real-Time Client Interface (30003)"),
            ("rtde", "Real-Time Data Exchange (RTDE) (30004)"),
            ("robot_api" if options else "dashboard", stops),
        ):
            remote.fault("listener_gone", service=service, seconds=0)
            condition = found(model, host)["services"]
            remote.fault("clear")
            assert not condition.holds, service
            assert name in condition.text
            assert "Settings > Security > Services" in condition.text
            closed = condition.text.partition(": switch")[0]
            assert ("Primary" in closed) == (service == "primary")
        assert eventually(lambda: found(model, host)["services"].holds, 20.0)
        truth = remote.truth()
        assert (truth["scripts_started"], truth["stops"]) == (0, [])


def test_of_a_controller_that_is_off_no_menu_is_named():
    """Nobody would find it there."""
    condition = found("ur5", "127.0.6.49")["services"]
    assert not condition.holds
    assert "Settings" not in condition.text
