"""The settings of one simulated arm."""

import ipaddress
import math
import re
from dataclasses import dataclass, field

from monitor.errors import BadInput
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.simulate.polyscope import BUILD_DATE, DEFAULT_VERSION, Version, X, robot_api_of
from monitor.simulate.program_tree import ProgramTree
from monitor.simulate.scenario import Scenario

RTDE_PORT, DASHBOARD_PORT, SCRIPT_PORTS = 30004, 29999, (30001, 30002, 30003)  # ur-rtde cannot use others
DEFAULT_COMMAND_PORT = 30020
DEFAULT_ROBOT_API_PORT = 80  # as on a real PolyScope X
PERSONALITIES = ("ideal", "recorded")
CONTROL_SCRIPTS = ("modelled", "executed")
PROTECTIVE_RUNTIMES = ("paused", "stopped", "playing")
PAYLOAD_COM_MAX_M = 2.0  # largest distance of a payload's centre of mass from the flange, along each axis


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulateSettings:
    """One simulated arm on one loopback address. `version` is that of PolyScope; its default is in DEFAULT_VERSION."""

    robot: str = "ur5"
    bind: str = "127.0.0.1"
    seed: int = 0  # of the measurement noise and of the wire's faults
    ambient_c: float = 22.0
    mounting: Mounting = field(default_factory=Mounting)
    payload_kg: float = 0.0
    payload_com_m: tuple[float, float, float] = (0.0, 0.0, 0.05)  # in the frame of the flange
    command_port: int = DEFAULT_COMMAND_PORT
    robot_api_port: int = DEFAULT_ROBOT_API_PORT  # of a PolyScope X
    version: str | None = None  # for example "3.15.8"
    serial: str = "20180500001"
    home_rad: tuple[float, ...] = (0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0)
    initial_temperature_c: tuple[float, ...] | None = None  # per joint; None means a powered arm at rest in equilibrium with the room
    wear_per_revolution: tuple[float, ...] | None = None  # per joint, at rated load; None means that of a healthy arm
    remote_control: bool = True  # the dashboard's reply to `is in remote control`
    current_noise: float = 1.0  # multiplies the noise of the recorded arms
    run_in: float = 0.0  # what rest adds to friction, gone after some 15 s of motion; 0.03 to 0.05 on a real UR10e
    scenario: Scenario | None = None  # the events and the room of this arm
    program: ProgramTree | None = None  # the production program that is loaded; it plays when somebody presses Play
    cell: str | None = None  # the production cell around the arm, by its name in the catalogue; its program plays from the start
    personality: str = "ideal"  # what an arm publishes beside its motion: "ideal", or "recorded" as real arms were recorded
    control_script: str = "modelled"  # what plays ur-rtde's control script: its model, or the interpreter of URScript
    protective_runtime: str = "paused"  # what a protective stop does to the program; it is not documented for real controllers

    def __post_init__(self) -> None:
        """Check the fields. Raises BadInput with the field, its value and what is expected."""
        check_loopback(self.bind)
        robot = load_robot(self.robot)
        for name, values in (("home_rad", self.home_rad), ("initial_temperature_c", self.initial_temperature_c)):
            if values is not None and (len(values) != robot.joints or not all(math.isfinite(v) for v in values)):
                raise BadInput(f"simulate: {name} = {values!r}; expected {robot.joints} finite numbers")
        rates = self.wear_per_revolution
        if rates is not None and (len(rates) != robot.joints or not all(0.0 <= rate < math.inf for rate in rates)):
            raise BadInput(f"simulate: wear_per_revolution = {self.wear_per_revolution!r}; expected {robot.joints} numbers, none negative")
        most_kg = 2.0 * robot.payload_max_kg
        for name, low, high, unit in (
            ("payload_kg", 0.0, most_kg, f" for a {self.robot}, twice its rated payload"),
            ("ambient_c", -20.0, 60.0, " °C"),
            ("run_in", 0.0, 1.0, " of friction"),
            ("current_noise", 0.0, 100.0, " times the recorded arms'"),
            ("seed", 0, math.inf, ""),
            ("command_port", 1, 65535, ""),
            ("robot_api_port", 1, 65535, ""),
        ):
            if not low <= getattr(self, name) <= high:
                raise BadInput(f"simulate: {name} = {getattr(self, name):g}; expected {low:g} … {high:g}{unit}")
        for name, words in (
            ("protective_runtime", PROTECTIVE_RUNTIMES),
            ("personality", PERSONALITIES),
            ("control_script", CONTROL_SCRIPTS),
        ):
            if getattr(self, name) not in words:
                raise BadInput(f"simulate: {name} = {getattr(self, name)!r}; expected one of {', '.join(words)}")
        if self.cell is not None and self.program is not None:
            raise BadInput(f"simulate: a cell ({self.cell}) and a program ({self.program.name}); expected one of them")
        for name, port, other in (("command_port", self.command_port, 30020), ("robot_api_port", self.robot_api_port, 8080)):
            if port in (RTDE_PORT, DASHBOARD_PORT, *SCRIPT_PORTS):
                raise BadInput(f"simulate: {name} = {port} is one of the robot's own ports; expected another, e.g. {other}")
        if self.command_port == self.robot_api_port:
            raise BadInput(f"simulate: command_port and robot_api_port are both {self.command_port}; expected two ports")
        if len(self.payload_com_m) != 3 or not all(abs(metres) <= PAYLOAD_COM_MAX_M for metres in self.payload_com_m):
            raise BadInput(
                f"simulate: payload_com_m = {self.payload_com_m!r}; expected x, y, z within ±{PAYLOAD_COM_MAX_M:g} m of the flange"
            )
        if not self.serial.isdigit():
            raise BadInput(f"simulate: serial = {self.serial!r}; expected digits only, ur-rtde refuses others")
        _ = self.polyscope

    @property
    def arm(self) -> Robot:
        """The published parameters of the robot."""
        return load_robot(self.robot)

    @property
    def tick_s(self) -> float:
        """The control period: 8 ms on CB3, 2 ms on the e-Series."""
        return 1.0 / self.arm.rate_hz

    @property
    def build_date(self) -> str:
        """The date when the emulated software was built."""
        return BUILD_DATE[self.polyscope.major]

    @property
    def polyscope(self) -> Version:
        """The version as four numbers.

        Raises BadInput for a text that is no version, for 5.0 … 5.3 and 3.0 … 3.3, with which ur-rtde 1.6.5 crashes, and for a PolyScope X
        without a Robot API.
        """
        text = self.version or DEFAULT_VERSION[self.arm.generation]
        if not re.fullmatch(r"\d+(\.\d+){1,3}", text):
            raise BadInput(f"simulate: version = {text!r}; expected MAJOR.MINOR[.BUGFIX[.BUILD]], e.g. 5.11.0")
        parts = ([int(part) for part in text.split(".")] + [0, 0])[:4]
        version = Version(*parts)
        if version.major == X and robot_api_of(version) is None:
            raise BadInput(f"simulate: version = {text!r}; expected 10.11 or newer: before it PolyScope X had no Robot API")
        if version.major not in {3, 5, X} or version.minor < 4:
            raise BadInput(f"simulate: version = {text!r}; expected 3.4 … 3.15 or 5.4 … 5.22: ur-rtde 1.6.5 crashes on older ones")
        if (version.major == 3) != (self.arm.generation == "cb3"):
            expected = "3.4 … 3.15" if version.major != 3 else "5.4 … 5.22, or 10.11 and newer,"
            raise BadInput(f"simulate: version = {text!r}; expected {expected} for a {self.robot}")
        return version

    @property
    def service_ports(self) -> dict[str, int]:
        """The ports on which the robot listens: a PolyScope X has a Robot API where the others have a dashboard server."""
        asked = {"robot_api": self.robot_api_port} if self.polyscope.major >= X else {"dashboard": DASHBOARD_PORT}
        return {"rtde": RTDE_PORT, **asked, **dict(zip(("primary", "secondary", "realtime"), SCRIPT_PORTS, strict=True))}


def check_loopback(address: str) -> None:
    """Check an address. Raises BadInput unless it is an IPv4 loopback address: nobody may take a simulated robot for a real one."""
    try:
        loopback = ipaddress.IPv4Address(address).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        raise BadInput(f"simulate: bind = {address!r}; expected a loopback address 127.x.y.z: the simulator is not for networks")
