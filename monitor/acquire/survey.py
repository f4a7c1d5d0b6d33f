"""What an arm says of itself, for a configuration that nobody has written yet. It is only listened to."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from monitor.acquire.driver import Driver, usual_driver
from monitor.acquire.safety.of_installation import angle_deg, offset_of
from monitor.acquire.safety.of_state import tilt_deg
from monitor.acquire.state import ArmState, Identity
from monitor.errors import RobotUnreachable
from monitor.identify.gains import gains_from_torque
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array

UPRIGHT_DEG = 5.0  # between the tool's accelerometer and a mounting that it shows
MOUNTINGS = ("ground", "ceiling", "wall")
NO_TCP_M, NO_TCP_DEG = 1e-3, 0.1  # a TCP nearer to the flange than this is the flange itself, within the calibration


ANSWERS_WITHOUT_DATA = Sentence("answers_without_data", "{host}: the controller answers, but no data came: {look_for}")


class Survey(NamedTuple):
    """What an arm says of itself; None and empty tuples where it says nothing."""

    identity: Identity | None = None
    state: ArmState | None = None
    model: str | None = None  # one of the shipped names
    problem: Reason | None = None  # why the arm says less than it could

    @property
    def serial(self) -> str | None:
        """The serial number of the arm."""
        return self.identity.serial if self.identity else None

    @property
    def payload_kg(self) -> float | None:
        """The payload of the controller's installation."""
        return None if self.state is None or not np.isfinite(self.state.payload_kg) else round(self.state.payload_kg, 3)

    @property
    def payload_cog_m(self) -> tuple[float, ...]:
        """(3,) the centre of gravity of that payload, in the flange's frame."""
        cog = () if self.state is None else self.state.payload_cog_m
        return tuple(round(value, 4) for value in cog) if cog and np.all(np.isfinite(cog)) else ()

    def mounting(self, robot: Robot) -> str | None:
        """ground, ceiling or wall, as the tool's accelerometer shows it; None where it shows none of them."""
        state = self.state
        if state is None or not np.all(np.isfinite([*state.accelerometer_m_s2, *state.q])):
            return None
        up = np.array(state.accelerometer_m_s2)
        fitting = [name for name in MOUNTINGS if tilt_deg(robot, Mounting.parse(name), state.q, up) <= UPRIGHT_DEG]
        return fitting[0] if len(fitting) == 1 else None

    def tcp_offset(self, robot: Robot) -> tuple[float, ...]:
        """(6,) the tool centre point in the flange's frame, position [m] and rotation vector [rad]; empty where it is not reported."""
        state = self.state
        if state is None or not state.tcp_pose or not np.all(np.isfinite([*state.q, *state.tcp_pose])):
            return ()
        place, turn = offset_of(robot, state.q, np.array(state.tcp_pose))
        vector = Rotation.from_matrix(turn).as_rotvec()
        if np.linalg.norm(place) < NO_TCP_M and angle_deg(turn) < NO_TCP_DEG:
            return (0.0,) * 6
        return tuple(round(float(value), 4) + 0.0 for value in (*place, *vector))


def survey(host: str, *, timeout_s: float = 5.0, driver: Driver | None = None) -> Survey:
    """Ask the controller. One that does not answer gives an empty survey with the problem."""
    driver = driver or usual_driver()
    try:
        identity = driver.identity(host)
    except RobotUnreachable as error:
        return Survey(problem=error.reason)
    state = driver.state(host, 125.0, timeout_s)
    problem = None if state is not None else ANSWERS_WITHOUT_DATA(host=host, look_for=driver.no_data)
    return Survey(identity=identity, state=state, model=driver.model_of(identity), problem=problem)


def reported_gains(host: str, *, driver: Driver | None = None) -> Array | None:
    """(J,) torque per ampere [N·m/A] that the controller's currents and torques show, NaN where they show none; None: it reports no torque.

    Raises RobotUnreachable.
    """
    rows = (driver or usual_driver()).currents_and_torques(host)
    return None if rows is None else gains_from_torque(rows[:, 0], rows[:, 1])


def published_gains(model: str) -> Array | None:
    """(J,) torque per ampere [N·m/A] that the package has for a model; None where it has none."""
    gains = load_robot(model).drive_gain_nm_per_a
    return gains if np.all(np.isfinite(gains)) else None
