"""What a controller reports about itself: version, control mode, roles, serial numbers and known variables."""

from monitor.errors import BadInput
from monitor.simulate.controller.published import OUTPUT_TYPES, known
from monitor.simulate.settings import SimulateSettings


class Identity:
    """The self-description of one controller. The pendant, the dashboard and faults change parts of it."""

    def __init__(self, settings: SimulateSettings) -> None:
        self._settings, self._polyscope = settings, settings.polyscope
        self.reported_version, self.remote_control = settings.polyscope, settings.remote_control
        self.user_role, self.operational_mode = "PROGRAMMER", "NONE"  # the dashboard sets them
        self.joint_serials = [f"{settings.serial}-{i + 1}" for i in range(settings.arm.joints)]
        self.missing_outputs: set[str] = set()  # a fault hides these output variables

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
        self.missing_outputs.clear()
