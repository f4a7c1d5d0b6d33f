"""Every shipped scenario does what it describes, and mistakes in scenarios are errors with a reason."""

from dataclasses import replace

import numpy as np
import pytest
from sim_pendant import Pendant
from sim_process import excitation

from monitor.errors import BadInput
from monitor.model.robot import Mounting, load_robot, robot_names
from monitor.simulate.commands import truth
from monitor.simulate.controller.controller import Controller
from monitor.simulate.launch import announcement, settings_from
from monitor.simulate.machine.state import SafetyMode
from monitor.simulate.scenario import (
    DAY_S,
    HOUR_S,
    Scenario,
    ScenarioEvent,
    Work,
    load_scenario,
    scenario_from_document,
    scenario_names,
)
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.simulate.wire.robot import ServedRobot
from monitor.simulate.wire.variables import output_variables


def living(name: str, **options) -> Controller:
    return Controller(settings_from(load_scenario(name), **options))


def friction(controller: Controller, joint: int) -> float:
    """Friction torque at 1 rad/s and 25 °C without load, which `percent_a_month` refers to."""
    return float(controller.arm.friction_torque(np.ones((1, 6)), np.zeros((1, 6)), np.full(6, 25.0))[0, joint - 1])


def live_days(controller: Controller, days: float) -> None:
    assert controller.pass_time(24.0 * days) == ""


@pytest.mark.parametrize("name", scenario_names())
def test_every_shipped_scenario_loads_and_has_a_description(name):
    """The command prints the name and the description of the scenario."""
    scenario = load_scenario(name)
    printed = announcement(settings_from(scenario))
    assert name in printed
    assert len(scenario.about) > 20
    assert scenario.about in printed


def test_all_required_scenarios_exist():
    asked = {"fresh", "joint-wearing", "step-wear", "cold-mondays", "hot-summer", "payload-undeclared", "remounted", "regreased"}
    assert asked | {"noisy-currents", "long-holiday", "joint-replaced"} <= set(scenario_names())


def test_a_joint_wears_five_percent_a_month():
    """Joint 3 wears with its work from day 14 on; the other joints hardly wear."""
    controller = living("joint-wearing")
    fresh = [friction(controller, joint) for joint in range(1, 7)]
    live_days(controller, 14)
    assert friction(controller, 3) == pytest.approx(fresh[2], rel=1e-3)
    live_days(controller, 60)
    grown = friction(controller, 3) / fresh[2] - 1.0
    assert grown == pytest.approx(0.10, abs=0.006)  # working days do not fall evenly into two months
    assert friction(controller, 2) == pytest.approx(fresh[1], rel=2e-3)


def test_step_wear_comes_from_one_moment_to_the_next():
    """Dry friction grows by 25 % on day 14."""
    controller = living("step-wear")
    live_days(controller, 13.99)
    assert controller.arm.wear.coulomb[1] < 1.001
    live_days(controller, 0.02)
    assert controller.arm.wear.coulomb[1] == pytest.approx(1.25, abs=1e-3)
    assert controller.arm.wear.viscous[1] == pytest.approx(1.10, abs=1e-3)
    assert controller.scenario.happened == ["day 14: wear_step joint=2 coulomb_factor=1.25 viscous_factor=1.1"]


def test_monday_morning_is_colder_than_friday_evening():
    """The difference is about 12 K, and at least 9 K in the grease."""
    controller = living("cold-mondays")
    live_days(controller, 4.45)  # from Monday 6 h to Friday about 17 h
    friday = controller.arm.temperatures.grease_c.copy()
    live_days(controller, 2.54)
    monday = controller.arm.temperatures.grease_c
    assert np.all(friday - monday > 9.0)
    assert controller.arm.ambient_c < 10.0


def test_a_hot_summer_is_hot_in_the_afternoon():
    """The temperature has a daily cycle around 33 °C."""
    controller = living("hot-summer")
    seen = []
    for _ in range(24):
        live_days(controller, 1 / 24)
        seen.append(controller.arm.ambient_c)
    assert (min(seen), max(seen)) == (pytest.approx(27.0, abs=0.3), pytest.approx(39.0, abs=0.3))


def test_a_payload_comes_undeclared():
    """From day 10 on the drives carry 2 kg. The controller's model and the published payload do not change."""
    controller = living("payload-undeclared")
    live_days(controller, 9.0)
    stretched = [np.zeros((1, 6))] * 3
    before = controller.arm.rigid_torque(*stretched)[0][0, 1]
    live_days(controller, 2.0)
    assert controller.arm.rigid_torque(*stretched)[0][0, 1] - before == pytest.approx(-2.0 * 9.81 * 0.82, rel=0.05)
    assert output_variables(controller)["payload"].read() == (0.0,)
    assert controller.arm.assumed_model is not controller.arm.model
    recording = stepped_replay(controller, excitation())
    assert recording.samples == 501  # the servo copes


def test_the_arm_hangs_from_the_ceiling_and_the_controller_does_not_know():
    """Gravity reverses for the drives alone, and a replay with the old configuration still runs."""
    controller = living("remounted")
    live_days(controller, 10.5)
    assert controller.arm.mounting == Mounting.parse("ceiling")
    assert np.allclose(controller.installation.gravity, [0.0, 0.0, -9.80665])
    recording = stepped_replay(controller, excitation())
    load = (recording.current - recording.target_current) * controller.arm.gain_nm_per_a
    assert np.abs(load[:, 1]).max() > 20.0  # N·m that the controller's model does not explain


def test_grease_takes_most_of_the_wear_away():
    """On day 40 the wear falls by four fifths."""
    controller = living("regreased")
    live_days(controller, 39.9)
    worn = controller.arm.wear.coulomb[2] - 1.0
    live_days(controller, 0.2)
    assert worn > 0.2
    assert controller.arm.wear.coulomb[2] - 1.0 == pytest.approx(0.2 * worn, rel=0.05)


def test_a_replaced_joint_has_its_own_serial_and_friction():
    controller = living("joint-replaced")
    before, other = friction(controller, 2), friction(controller, 3)
    live_days(controller, 20.1)
    assert truth(controller)["joint_serials"][1] == "20260200417"
    assert friction(controller, 2) == pytest.approx(0.88 * before, rel=1e-3)
    assert friction(controller, 3) == pytest.approx(other, rel=1e-3)


def test_noisy_currents_have_four_times_the_noise():
    spreads = []
    for controller in (living("fresh"), living("noisy-currents")):
        currents = []
        for _ in range(500):
            controller.step()
            currents.append(controller.measurements.latest.current)
        spreads.append(np.std(currents, axis=0))
    assert np.allclose(spreads[1] / spreads[0], 4.0, rtol=0.05)  # the same random numbers


def test_on_holiday_the_arm_rests():
    """The joints do not turn for three weeks, and then they work again."""
    controller = living("long-holiday")
    live_days(controller, 28)
    worked = controller.arm.wear.revolutions.copy()
    live_days(controller, 21)
    assert np.array_equal(controller.arm.wear.revolutions, worked)
    live_days(controller, 3)
    assert np.all(controller.arm.wear.revolutions > worked)


def test_stepped_and_tick_by_tick_give_the_same_life():
    """An event and the temperature come at the same age, whether time passes at once or by control periods."""
    event = ScenarioEvent(at_s=2.0, do="wear_step", arguments={"joint": 1, "coulomb_factor": 1.5, "viscous_factor": 1.0})
    ticked, leapt = (Controller(SimulateSettings(scenario=Scenario(events=(event,)))) for _ in range(2))
    for _ in range(round(3.0 / ticked.clock.tick_s)):
        ticked.step()
    leapt.pass_time(3.0 / 3600.0)
    for controller in (ticked, leapt):
        assert controller.arm.wear.coulomb[0] == pytest.approx(1.5, abs=1e-6)
    assert np.allclose(ticked.arm.temperatures.motor_c, leapt.arm.temperatures.motor_c, atol=0.02)


def test_a_fault_may_be_part_of_a_scenario():
    """A fault of the controller needs no wire."""
    document = {"event": [{"at_s": 0.5, "do": "fault", "fault": "protective_stop", "runtime": "stopped"}]}
    controller = Controller(settings_from(scenario_from_document(document, "mine", "mine.toml")))
    for _ in range(200):
        controller.step()
    assert controller.modes.safety == SafetyMode.PROTECTIVE_STOP


@pytest.mark.parametrize("robot", robot_names())
@pytest.mark.parametrize("mounting", ["20,-35,60", *(pytest.param(name, marks=pytest.mark.soak) for name in ("ground", "ceiling"))])
def test_every_model_moves_on_any_mounting_with_a_payload(robot, mounting):
    """A move of half a radian with half the payload reaches its goal without a stop, below the torque limits."""
    settings = SimulateSettings(robot=robot, mounting=Mounting.parse(mounting), payload_kg=0.5 * load_robot(robot).payload_max_kg)
    pendant = Pendant()
    pendant.controller = controller = Controller(settings)
    goal = np.array(settings.home_rad) + np.array([0.5, 0.3, -0.5, 0.5, 0.5, 0.5])
    controller.reference.move(goal, 1.0, 1.5)
    largest = np.zeros(6)
    while not controller.reference.at_rest:
        controller.step()
        largest = np.maximum(largest, np.abs(controller.arm.torque_nm))
    pendant.run(0.3)
    assert controller.modes.safety == SafetyMode.NORMAL
    assert np.allclose(controller.arm.q, goal, atol=2e-3)
    assert np.all(largest < controller.robot.max_torque_nm)


@pytest.mark.parametrize(
    ("document", "named"),
    [
        ({"abuot": "x"}, "abuot"),
        ({"about": 3}, "about"),
        ({"starts": "Monday"}, "starts"),
        ({"arm": {"robot": 5}}, "robot"),
        ({"arm": {"weight": 5}}, "weight"),
        ({"arm": 5}, "arm"),
        ({"room": {"mean_c": 99}}, "mean_c"),
        ({"room": {"mean_c": float("nan")}}, "mean_c"),
        ({"production": {"days": [0]}}, "days"),
        ({"production": {"from_h": 9, "to_h": 8}}, "from_h"),
        ({"production": {"pauses": [[5, 3]]}}, "pauses"),
        ({"event": {"do": "wear"}}, "list"),
        ({"event": [{"at_day": 1, "do": "explode"}]}, "explode"),
        ({"event": [{"do": "wear", "joint": 1, "percent_a_month": 5}]}, "when"),
        ({"event": [{"at_day": 1, "at_s": 1, "do": "wear"}]}, "when"),
        ({"event": [{"at_day": -1, "do": "wear", "joint": 1, "percent_a_month": 5}]}, "at_day"),
        ({"event": [{"at_day": 1, "do": "wear", "joint": 0, "percent_a_month": 5}]}, "joint"),
        ({"event": [{"at_day": 1, "do": "wear", "joint": 1}]}, "percent_a_month is missing"),
        ({"event": [{"at_day": 1, "do": "payload", "kg": 1, "declared": "no"}]}, "declared"),
        ({"event": [{"at_day": 1, "do": "mounting", "mounting": "sideways"}]}, "sideways"),
        ({"event": [{"at_day": 1, "do": "fault", "fault": "stall"}]}, "seconds"),
    ],
)
def test_mistakes_in_a_scenario_are_named(document, named):
    with pytest.raises(BadInput, match=named):
        scenario_from_document(document, "mine", "mine.toml")


def test_a_payload_that_the_arm_cannot_carry_is_refused_before_it_starts():
    document = {"arm": {"robot": "ur3"}, "event": [{"at_day": 1, "do": "payload", "kg": 50}]}
    with pytest.raises(BadInput, match="50 kg"):
        settings_from(scenario_from_document(document, "mine", "mine.toml"))


def test_a_missing_scenario_and_an_invalid_file_are_named(tmp_path):
    """The errors name the shipped scenarios, or the line of the mistake."""
    with pytest.raises(BadInput, match="cold-mondays"):
        load_scenario("sunshine")
    with pytest.raises(BadInput, match="cannot be read"):
        load_scenario(str(tmp_path / "none.toml"))
    (tmp_path / "broken.toml").write_text("[arm\n")
    with pytest.raises(BadInput, match="line 1"):
        load_scenario(str(tmp_path / "broken.toml"))
    (tmp_path / "mine.toml").write_text('about = "Mine, hung on a wall."\n[arm]\nrobot = "ur3e"\nmounting = "wall"\n')
    settings = settings_from(load_scenario(str(tmp_path / "mine.toml")), seed=3)
    assert (settings.robot, settings.seed, settings.mounting) == ("ur3e", 3, Mounting.parse("wall"))


def test_production_counts_its_hours():
    """Half of ten hours on five days of the week: 107 hours in thirty days, and none on a Sunday."""
    production = Work()
    assert production.duty_hours_a_month == pytest.approx(0.5 * 10 * 5 * 30 / 7)
    week = [production.duty_at(hour * HOUR_S, hour / 24) for hour in range(168)]
    assert sum(week) == pytest.approx(25.0)
    assert not any(week[6 * 24 :])
    assert replace(production, pauses=((0.0, 7.0),)).duty_at(10 * HOUR_S, 10 * HOUR_S / DAY_S) == 0.0


@pytest.mark.parametrize("fault", [{"fault": "text_at_connect"}, {"fault": "not_found", "names": "actual_q"}])
def test_a_fault_may_be_there_from_the_first_moment_on(fault):
    """It waits for the first control period, when controller and wire exist."""
    event = {"at_s": 0, "do": "fault", **fault}
    scenario = scenario_from_document({"event": [event]}, "from-the-start", "from-the-start.toml")
    robot = ServedRobot(SimulateSettings(scenario=scenario), {}, lambda: None)
    robot.controller.step()
    assert robot.ports.faults.text_at_connect or "actual_q" in robot.controller.identity.missing_outputs
    assert len(robot.controller.scenario.happened) == 1


@pytest.mark.parametrize(
    ("document", "named"),
    [
        ({"event": [{"at_s": 9, "do": "fault", "fault": "version", "version": "new"}]}, "MAJOR.MINOR"),
        ({"event": [{"at_s": 9, "do": "fault", "fault": "version", "version": "5.999"}]}, "255"),
        ({"event": [{"at_s": 9, "do": "fault", "fault": "not_found", "names": "nonsense"}]}, "nonsense"),
        ({"event": [{"at_s": 9, "do": ["wear"]}]}, "expected one of"),
        ({"production": {"duty": 0.0}, "event": [{"at_s": 9, "do": "wear", "joint": 3, "percent_a_month": 5.0}]}, "duty above 0"),
    ],
)
def test_mistakes_in_later_events_are_named_at_the_start(document, named):
    """The error comes when the controller starts, and not after days in the middle of a control period."""
    with pytest.raises(BadInput, match=named):
        Controller(SimulateSettings(scenario=scenario_from_document(document, "mine", "mine.toml")))
