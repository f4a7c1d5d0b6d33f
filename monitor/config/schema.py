"""The schema of a configuration: the sections of its file, each the settings of one room, and the checked configuration as a value."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_type_hints

import numpy as np
from annotated_types import Interval

from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.acquire.settings import Installation, ProductionListenSettings, ReplaySettings
from monitor.config.notify import NotifySettings
from monitor.errors import BadInput
from monitor.judge.inspection import InspectionSettings
from monitor.judge.settings import AssessSettings
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.publish.session import BusSettings, MetricsSettings, prefix
from monitor.recording import Array, Context
from monitor.store.archive.places import BUCKET, ENDPOINT, FOLDER, ArchiveSettings
from monitor.views.web.settings import PageSettings

if TYPE_CHECKING:
    from monitor.acquire.driver import Driver


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSettings:
    """Which arm this is, where it is, and what it carries."""

    model: str  # a name from monitor/model/robots, e.g. "ur5"
    site: str  # part of the Zenoh keys: a–z, 0–9, _ and -
    id: str  # the same; unique within the site
    host: str = "127.0.0.1"  # address of the controller
    robot_api_port: Annotated[int, Interval(ge=1, le=65535)] = 80  # of a PolyScope X (software 10), which has no dashboard
    listen_hz: Annotated[float, Interval(ge=1.0, le=125.0)] = 10.0  # [Hz] rate at which its state is received between replays
    mounting: str = "ground"  # ground, ceiling, wall, or "ROLL,PITCH,YAW" in degrees
    payload_kg: Annotated[float, Interval(ge=0.0, le=100.0)] = 0.0  # [kg] as set in the controller
    tool: str = "none"
    serial: str | None = None
    joint_serials: tuple[str, ...] = ()  # base to wrist, as on the type plates; a changed one means a new joint without wear
    maintenance: str = ""  # the last maintenance that may have changed friction, as text; with another text friction may have moved
    gains_nm_per_a: tuple[float, ...] = ()  # [N·m/A] joint torque per ampere; empty: the published torque constants
    payload_cog_m: tuple[float, ...] = ()  # [m] as set in the controller; empty: it is not compared
    tcp_offset: tuple[float, ...] = ()  # [m, m, m, rad, rad, rad] as set in the controller; empty: it is not compared
    tcp_speed_limit_m_s: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.0  # [m/s] of the controller's safety settings; 0: not checked
    safety_planes: tuple[tuple[float, ...], ...] = ()  # of the controller's safety settings; empty: not checked


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreSettings:
    """Where the history lives."""

    directory: str = "var/joint-monitor"  # relative to the configuration file
    backups: Annotated[int, Interval(ge=1, le=365)] = 14  # days of which the newest backup is kept
    recordings_days: Annotated[float, Interval(ge=0.0, le=36500.0)] = (
        1825.0  # [d] older recordings are pruned, their assessments stay; 0: no limit
    )
    recordings_gb: Annotated[float, Interval(ge=0.0, le=1e6)] = 20.0  # [GB] the oldest recordings beyond this total are pruned; 0: no limit
    least_free_mb: Annotated[float, Interval(ge=1.0, le=1e6)] = 500.0  # [MB] with less free space on the disk nothing is replayed
    recordings: str = ""  # an archive: s3://BUCKET/PREFIX, or a folder, relative to the configuration file; empty: there is none
    recordings_endpoint: str = ""  # of an S3 server that is not Amazon's, e.g. https://minio.example:9000
    recordings_region: str = ""
    recordings_keys_file: str = ""  # as ~/.aws/credentials; may begin with ${CREDENTIALS_DIRECTORY}
    recordings_ca_file: str = ""  # PEM, where an authority of one's own signed the server's certificate
    keep_local_days: Annotated[float, Interval(ge=0.0, le=36500.0)] = 0.0  # [d] with an archive; 0: as recordings_days

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong. An address is not repeated: somebody may have written a key into it."""
        if "://" in self.recordings and not BUCKET.match(self.recordings):
            raise BadInput('recordings = …; expected "s3://BUCKET/PREFIX" without user, query or blanks, or the path of a folder')
        if self.recordings_endpoint and not ENDPOINT.match(self.recordings_endpoint):
            raise BadInput("recordings_endpoint = …; expected http:// or https://, the server's name, and perhaps :PORT")
        if self.keep_local_days and not self.recordings:
            raise BadInput("keep_local_days = …; it is for recordings that an archive has as well: name that in recordings")


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowSettings:
    """The part of `AssessSettings` that belongs to no single room."""

    method: Literal["ls", "wls"] = "wls"


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """The checked configuration of one robot, as `joint-monitor run` needs it."""

    path: Path
    robot: RobotSettings
    schedule: ScheduleSettings
    store: StoreSettings
    replay: ReplaySettings
    bus: BusSettings
    metrics: MetricsSettings
    page: PageSettings
    assess: AssessSettings
    excitation: Excitation
    production: ProductionListenSettings = dataclasses.field(default_factory=ProductionListenSettings)
    inspection: InspectionSettings = dataclasses.field(default_factory=InspectionSettings)
    notify: NotifySettings = dataclasses.field(default_factory=NotifySettings)
    prior_of_plant: bool = False  # [drift] prior = "plant"; what was taken stands in the history, see `service.plant_prior`
    overrides: tuple[str, ...] = ()  # variables of the environment that replace values of the file

    @property
    def driver(self) -> "Driver":
        """How this arm's controller is asked and driven."""
        from monitor.acquire.driver import driver_of  # every command reads a configuration, few ask a controller

        return driver_of("universal_robots", robot_api_port=self.robot.robot_api_port)

    @property
    def robot_description(self) -> Robot:
        """The robot's published parameters."""
        return load_robot(self.robot.model)

    @property
    def mounting(self) -> Mounting:
        """How the base stands in the world."""
        return Mounting.parse(self.robot.mounting)

    @property
    def gains_nm_per_a(self) -> Array | None:
        """(J,) joint torque per ampere [N·m/A]; None where the published torque constants hold."""
        return np.array(self.robot.gains_nm_per_a) if self.robot.gains_nm_per_a else None

    @property
    def installation(self) -> Installation:
        """What the file says of the controller's installation and of the drives."""
        robot = self.robot
        return Installation(
            gains_nm_per_a=robot.gains_nm_per_a,
            payload_cog_m=robot.payload_cog_m,
            tcp_offset=robot.tcp_offset,
            tcp_speed_limit_m_s=robot.tcp_speed_limit_m_s,
            safety_planes=robot.safety_planes,
        )

    @property
    def key_prefix(self) -> str:
        """The key below which this robot's keys lie on the bus."""
        return prefix(self.robot.site, self.robot.id)

    @property
    def state_directory(self) -> Path:
        """The absolute path of the history's folder."""
        return (self.path.parent / self.store.directory).resolve()

    @property
    def archive(self) -> ArchiveSettings | None:
        """Where the recordings go besides; None: nowhere. Relative paths start from the folder of the file."""
        store, folder = self.store, self.path.parent
        if not store.recordings:
            return None
        keys_file = store.recordings_keys_file
        return ArchiveSettings(
            address=store.recordings if "://" in store.recordings else str((folder / store.recordings).resolve()),
            endpoint=store.recordings_endpoint,
            region=store.recordings_region,
            keys_file=keys_file if not keys_file or keys_file.startswith(FOLDER) else str((folder / keys_file).resolve()),
            ca_file=str((folder / store.recordings_ca_file).resolve()) if store.recordings_ca_file else "",
        )

    @property
    def context(self) -> Context:
        """The context that every recording of this robot shares."""
        return Context(
            robot=self.robot.model,
            serial=self.robot.serial,
            mounting_rad=self.mounting.angles_rad,
            payload_kg=self.robot.payload_kg,
            tool=self.robot.tool,
            joint_serials=self.robot.joint_serials or None,
            maintenance=self.robot.maintenance or None,
            trajectory_digest=self.excitation.digest,
        )


def section_classes() -> dict[str, type]:
    """The sections of the file, each the settings of one room, by name: the fields of `Configuration` and of `AssessSettings`."""
    hints = get_type_hints(Configuration)
    rooms = {name: hint for name, hint in hints.items() if dataclasses.is_dataclass(hint) and hint not in (AssessSettings, Excitation)}
    return rooms | assess_sections() | {"assess": FlowSettings}  # type: ignore[return-value]


def assess_sections() -> dict[str, type]:
    """The sections that are one value each within `AssessSettings`, by name."""
    hints = get_type_hints(AssessSettings)
    return {field.name: hints[field.name] for field in dataclasses.fields(AssessSettings) if dataclasses.is_dataclass(hints[field.name])}


def text_keys() -> set[str]:
    """Every key that holds text, as `section.key`, also where its text looks like a number: a serial number is all digits."""
    keys: set[str] = set()

    def collect(cls: type, place: str) -> None:
        for name, hint in get_type_hints(cls).items():
            if isinstance(hint, type) and dataclasses.is_dataclass(hint):
                collect(hint, f"{place}.{name}")
            elif hint is str or hint == str | None:
                keys.add(f"{place}.{name}")

    for name, cls in section_classes().items():
        collect(cls, name)
    return keys | {"replay.excitation", "replay.cell", "drift.prior"}
