"""What faults act on."""

from collections.abc import Callable
from dataclasses import dataclass, field

from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.reference import Reference
from monitor.simulate.controller.faults.foreign import ForeignPrograms
from monitor.simulate.controller.identity.identity import Identity
from monitor.simulate.controller.measurements import Measurements
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.runner import Programs
from monitor.simulate.controller.registers import Registers
from monitor.simulate.controller.safety import Safety
from monitor.simulate.faults import FaultyWire
from monitor.simulate.settings import SimulateSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultTarget:
    """Parts of a controller, and its wire if it has one."""

    settings: SimulateSettings
    identity: Identity
    registers: Registers
    measurements: Measurements
    arm: Arm
    reference: Reference
    machine: Machine
    programs: Programs
    foreign: ForeignPrograms
    safety: Safety
    wire: FaultyWire | None
    restore: dict[str, Callable[[], object]] = field(default_factory=dict)  # for each lasting fault, what `clear` does to end it

    def lasts(self, fault: str, end: Callable[[], object]) -> None:
        """Let `clear` end this fault. What was before the first of several stays to be restored."""
        self.restore.setdefault(fault, end)

    def clear(self) -> None:
        """End the lasting faults that were registered."""
        while self.restore:
            self.restore.popitem()[1]()
