"""What a controller reports about itself: version, control mode, roles, serial numbers and known variables."""

from collections.abc import Iterable

from monitor.errors import BadInput
from monitor.simulate.controller.identity.published import OUTPUT_TYPES, known
from monitor.simulate.polyscope import Version, X
from monitor.simulate.settings import SimulateSettings


class Identity:
    """The self-description of one controller. The pendant, the dashboard and faults change parts of it."""

    def __init__(self, settings: SimulateSettings) -> None:
        self._settings, self._polyscope = settings, settings.polyscope
        self.reported_version, self.remote_control = settings.polyscope, settings.remote_control
        # the dashboard sets them; a PolyScope X is always in one of two modes
        self.user_role, self.operational_mode = "PROGRAMMER", "AUTOMATIC" if settings.polyscope.major >= X else "NONE"
        self.joint_serials = [f"{settings.serial}-{i + 1}" for i in range(settings.arm.joints)]
        self.missing_outputs: set[str] = set()  # a fault hides these output variables

    def report_version(self, version: Version) -> None:
        """Report another version of PolyScope than the one that runs."""
        self.reported_version = version

    def hide_outputs(self, names: Iterable[str]) -> None:
        """Deny that these output variables exist."""
        self.missing_outputs.update(names)

    def set_remote_control(self, on: bool) -> None:
        """Switch between remote and local control."""
        self.remote_control = on

    def set_manual(self, on: bool) -> None:
        """Switch between manual and automatic mode at the pendant. Remote control is only possible in automatic mode."""
        self.operational_mode = "MANUAL" if on else "AUTOMATIC"
        if on:
            self.remote_control = False

    @property
    def local(self) -> bool:
        """Whether the pendant has taken control: commands over the network are then refused. A CB3 has no such mode."""
        return not self.remote_control and self._polyscope.major >= 5

    def clear_operational_mode(self) -> None:
        """The dashboard no longer sets the operational mode."""
        self.operational_mode = "NONE"

    def take_over(self, before: "Identity") -> None:
        """Keep what a restart does not change: the joints in the arm."""
        self.joint_serials = before.joint_serials

    def knows(self, name: str) -> bool:
        """Whether this version of PolyScope has a variable of this name, if any version has it."""
        return known(name, self._polyscope)

    def publishes(self, name: str) -> bool:
        """Whether a client can subscribe to the output variable of this name now."""
        return name in OUTPUT_TYPES and self.knows(name) and name not in self.missing_outputs

    def outputs(self, names: str) -> list[str]:
        """The output variables in a comma-separated list of names.

        Raises BadInput with the names that this controller does not have.
        """
        wanted = [name for name in names.split(",") if name]
        unknown = [name for name in wanted if name not in OUTPUT_TYPES or not self.knows(name)]
        if unknown:
            raise BadInput(f"fault not_found: {', '.join(unknown)} is no output of this controller")
        return wanted

    def restore(self) -> None:
        """Report again what the settings say."""
        self.reported_version, self.remote_control = self._polyscope, self._settings.remote_control
        if self._polyscope.major >= X:
            self.operational_mode = "AUTOMATIC"
        self.missing_outputs.clear()
