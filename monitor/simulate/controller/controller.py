"""One simulated controller with its arm. It opens no socket and reads no wall clock.

`Controller.step` computes one control period in this order: scenario, programs, reference, servo and physics, sensors, supervision.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.friction import FrictionLaw
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.physics import Arm
from monitor.simulate.arm.reference import Reference
from monitor.simulate.arm.sensors import Sensors
from monitor.simulate.arm.thermal import Temperatures
from monitor.simulate.controller.faults import Effect, ForeignPrograms, Parts, inject
from monitor.simulate.controller.safety import Safety
from monitor.simulate.controller.scenario_player import ScenarioPlayer
from monitor.simulate.machine.identity import Identity
from monitor.simulate.machine.journal import CLIENT, Journal
from monitor.simulate.machine.machine import Installation, Machine, Measurements, Watchdog
from monitor.simulate.machine.moves import Compliance, Limits, Moves
from monitor.simulate.machine.personality import personality_of
from monitor.simulate.machine.registers import Recipe, Registers
from monitor.simulate.machine.state import DEVIATES, Clock, ErrorCode, Modes, RobotMode
from monitor.simulate.program.runner import Programs, Surroundings
from monitor.simulate.program.scripts import Immediate, parse
from monitor.simulate.scenario import Scenario
from monitor.simulate.settings import SimulateSettings

SUBSTEP_S = 0.002  # period of servo and integration; it is the e-Series' own control period
SCENARIO_EVERY_S = 1.0  # how often the scenario's events and the temperature of the room are checked


class Controller(Parts):
    """Composes the parts of one controller, and advances them together. `machine` holds the parts that programs use."""

    def __init__(
        self,
        settings: SimulateSettings,
        *,
        before: "Controller | None" = None,
        law: FrictionLaw | None = None,
        wire: Mapping[str, Effect] | None = None,
        surroundings: Surroundings | None = None,
    ) -> None:
        """Start a controller.

        before : the controller that ran on the same arm until it was killed. The arm with its heat and wear is taken over.
        law : the friction of the arm; None means the default of the robot. A controller that takes over an arm ignores it.
        wire : the faults of the wire, by name; None if there is no wire.
        surroundings : the cell around the arm, whose program is loaded; None if nothing stands there.

        Raises BadInput where the scenario names outputs that this controller does not have.
        """
        self.settings, self.robot, self.personality = settings, settings.arm, personality_of(settings)
        self.wire, self.restore = wire or {}, {}
        self.scenario: ScenarioPlayer = ScenarioPlayer(settings.scenario or Scenario()) if before is None else before.scenario
        self.clock = Clock(settings.tick_s, self.scenario.lived_s)
        self.modes, self.journal, self.identity = Modes(), Journal(self.clock), Identity(settings)
        self.arm = _new_arm(settings, law) if before is None else before.arm
        if before is not None:
            self.arm.brake()
            self.arm.powered = False
        self.surroundings = surroundings
        self.kinematics, self.reference = Kinematics(self.robot), Reference(self.robot, self.arm.encoders()[0], settings.tick_s)
        self.measurements = Measurements(self.arm, Sensors(self.robot, settings.seed, settings.tick_s, settings.current_noise))
        if before is None:
            self.arm.strain(self.personality.held_nm())
        self.registers = Registers(self.identity.knows)
        self.installation = Installation(settings, self.robot, self.arm)
        self.machine = self._assembled()
        self.programs = Programs(self.machine, surroundings)
        self.safety = Safety(self.machine, self.programs)
        self.foreign = ForeignPrograms(self.machine, self.programs)
        self._scenario_every = max(1, round(SCENARIO_EVERY_S / settings.tick_s))
        self._substeps = max(1, round(settings.tick_s / SUBSTEP_S))
        if before is None:
            self._begin_scenario()
        else:
            self._take_over(before)
        self._check_scenario()

    def _assembled(self) -> Machine:
        """The parts that programs use."""
        limits = Limits(self.robot, self.clock.tick_s)
        moves = Moves(
            robot=self.robot,
            reference=self.reference,
            kinematics=self.kinematics,
            limits=limits,
            clock=self.clock,
            modes=self.modes,
            supervisor=self,
        )
        return Machine(
            settings=self.settings,
            personality=self.personality,
            robot=self.robot,
            arm=self.arm,
            clock=self.clock,
            modes=self.modes,
            registers=self.registers,
            measurements=self.measurements,
            reference=self.reference,
            kinematics=self.kinematics,
            limits=limits,
            moves=moves,
            compliance=Compliance(self.arm, self.reference, self.kinematics, self.personality),
            installation=self.installation,
            journal=self.journal,
            watchdog=Watchdog(self.clock),
            supervisor=self,
        )

    def _begin_scenario(self) -> None:
        self.scenario.advance(0.0, self)
        if self.scenario.scenario.room is not None:
            self.arm.set_temperatures(self.arm.thermal.idle(self.arm.ambient_c))

    def _take_over(self, before: "Controller") -> None:
        """Keep what a restart does not change: faults of sensors, wiring, installation and the arm's joints. The power is off."""
        self.identity.take_over(before.identity)
        self.journal.logbook.take_over(before.journal.logbook)
        self.registers.digital_inputs = before.registers.digital_inputs
        self.measurements.take_over(before.measurements)
        self.installation.take_over(before.installation)
        self.safety.power_off()

    def _check_scenario(self) -> None:
        """Report an impossible fault of the scenario now, and not when its day comes."""
        for event in self.scenario.scenario.events:
            if event.arguments.get("fault") == "not_found":
                self.identity.outputs(event.arguments["with"]["names"])

    # --- one control period -------------------------------------------------------------------------------------
    def step(self) -> None:
        """Advance by one control period."""
        self.clock.tick()
        if self.clock.ticks % self._scenario_every == 0 or self.clock.ticks == 1:
            self.scenario.advance(self.clock.lived_s, self)
        for script in self.foreign.step():
            self._run(script)
        self.programs.step()
        if self.surroundings is not None:
            self.surroundings.step(self.machine)
        self._move()
        self.arm.settle(self.clock.tick_s)
        self.measurements.record()
        self.journal.logbook.watch(self.arm.qd, None if self.arm.contact is None else self.arm.contact.torque_nm(self.arm.q))
        self.safety.supervise()

    def _move(self) -> None:
        """Let the servo drive the arm along the reference for one control period."""
        arm, reference, measurements, tick_s = self.arm, self.reference, self.measurements, self.clock.tick_s
        if self.modes.robot != RobotMode.RUNNING:  # the brakes hold the arm
            return
        compliance = self.machine.compliance
        if compliance.any and compliance.step(tick_s, self._substeps, measurements.encoder_q):
            return
        if reference.at_rest and arm.stand(tick_s, measurements.true_target(reference.step(tick_s))):  # friction holds the arm
            return
        h = tick_s / self._substeps
        targets = reference.steps(h, self._substeps)
        if not math.isfinite(sum(reference.q.tolist())):  # an arm whose position is not a number would never recover
            reference.reset(measurements.encoder_q)
            self.protective_stop("the motion that was asked for is not a number")
            targets = reference.steps(h, self._substeps)
        for target in targets:
            arm.step(h, measurements.true_target(target))

    # --- from outside -------------------------------------------------------------------------------------------
    def write_inputs(self, written: Recipe, values: Sequence[float]) -> None:
        """Take over one packet of inputs."""
        if self.registers.write(written, values):
            self.reference.speed_slider = self.registers.speed_fraction
        self.programs.received(written)

    def run_script(self, text: str) -> None:
        """Run one complete script. A script that is not understood is refused and recorded in the journal."""
        if self.identity.local:
            self.journal.refused_scripts.append("the robot is in local control")
        elif not self.foreign.holds(text):
            self._run(text)

    def _run(self, text: str) -> None:
        script = parse(text, recognise=self.settings.control_script == "modelled", version=self.settings.polyscope)
        if not isinstance(script, Immediate):
            self.programs.start(script)
            return
        match script.line:
            case "set unlock protective stop":  # the controller itself does not ask for the dashboard's five seconds
                self.safety.unlock(after_s=0.0)
            case "power on":
                self.safety.power(RobotMode.IDLE)
            case "power off":
                self.safety.power(RobotMode.POWER_OFF)
            case "set robotmode run":
                self.safety.power(RobotMode.RUNNING)
            case "stop program" | "halt":
                self.programs.stop(f"script: {script.line}", by=CLIENT)

    def stop_program(self, reason: str, *, kind: str = "program_stop") -> bool:
        """End the program; the arm decelerates to standstill. Returns False if no program was running."""
        return self.programs.stop(reason, kind=kind)

    def raise_exception(self, text: str) -> None:
        """End the program by a runtime exception."""
        self.programs.fail(text)

    def protective_stop(self, reason: str, code: ErrorCode = DEVIATES, joint: int | None = None) -> None:
        """Halt the arm; the settings say what becomes of the program."""
        self.safety.protective_stop(reason, code, joint)

    def tool_force(self) -> Array:
        """(6,) force [N] and torque [N·m] at the tool as the controller shows them."""
        return self.personality.tool_force() if self.surroundings is None else self.surroundings.wrench(self.machine)

    def acknowledge(self) -> None:
        """Unlock a protective stop and let the program play on, as a person does at the pendant."""
        if self.safety.unlock():
            self.programs.play()

    def inject(self, fault: str, arguments: dict[str, Any]) -> str:
        """Make one fault happen. Returns a sentence that says what was done. Raises BadInput for what is unknown or impossible."""
        return inject(fault, arguments, self)

    def pass_time(self, hours: float, ambient_c: float | None = None, duty: float | None = None) -> str:
        """Let hours pass without computing motion, in a room at this temperature, with this share of work.

        None means as in the scenario. Returns why this is not possible, or an empty text.
        """
        if self.programs.current is not None:
            return "a program is running"
        self.scenario.leap(self, 3600.0 * hours, ambient_c, duty)
        self.measurements.read()
        return ""


def _new_arm(settings: SimulateSettings, law: FrictionLaw | None) -> Arm:
    arm = Arm(
        settings.arm,
        q=np.array(settings.home_rad),
        ambient_c=settings.ambient_c,
        mounting=settings.mounting,
        payload_kg=settings.payload_kg,
        payload_com_m=settings.payload_com_m,
        law=law,
        run_in=settings.run_in,
        wear_per_revolution=None if settings.wear_per_revolution is None else np.array(settings.wear_per_revolution),
    )
    if settings.initial_temperature_c is not None:
        start = np.array(settings.initial_temperature_c)
        arm.set_temperatures(Temperatures(start, start.copy()))
    return arm
