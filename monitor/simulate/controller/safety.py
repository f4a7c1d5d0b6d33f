"""Safety and power of a controller: protective stop, emergency stop, power, and the supervision of the arm."""

import numpy as np

from monitor.simulate.machine.journal import ErrorMessage, SafetyMessage
from monitor.simulate.machine.machine import Machine
from monitor.simulate.machine.state import DEVIATES, ErrorCode, RobotMode, Runtime, SafetyMode
from monitor.simulate.program.runner import Programs

SAFETY_STOP_RAD_S2 = 25.0  # deceleration of protective and emergency stops
UNLOCK_AFTER_S = 5.0  # a protective stop cannot be unlocked earlier; the dashboard's reply names this time


class Safety:
    """Supervises one machine."""

    def __init__(self, machine: Machine, programs: Programs) -> None:
        self._machine, self._programs = machine, programs
        self._protected_at_s = 0.0  # when the last protective stop began
        self._resume_at_s: float | None = None  # when the safeguard is closed again; None while it is not open, or for good
        self._resumes = False  # whether the safeguard paused a program

    def supervise(self) -> None:
        """Check the arm after a control period, and note when it has come to rest after a stop."""
        machine, modes = self._machine, self._machine.modes
        if self._resume_at_s is not None and machine.clock.now_s >= self._resume_at_s:
            self.close_safeguard()
        if modes.robot == RobotMode.RUNNING and modes.unstopped:
            broken = machine.limits.broken(machine.reference.q, machine.measurements.encoder_q, machine.arm.torque_nm)
            if broken:
                self.protective_stop(broken.text, joint=broken.joint)
        if machine.journal.has_open_stops and machine.standing:
            machine.journal.close_stops()
            if modes.safety == SafetyMode.ROBOT_EMERGENCY_STOP:
                self.power_off()

    @property
    def deviation_ratio(self) -> float:
        """Following error divided by the one that leads to a protective stop."""
        return self._machine.limits.deviation_ratio(self._machine.reference.q, self._machine.measurements.encoder_q)

    def protective_stop(self, reason: str, code: ErrorCode = DEVIATES, joint: int | None = None, *, runtime: str | None = None) -> None:
        """Halt the arm.

        joint : that noticed it, from 1; None means that which is farthest from its target. runtime : what becomes of the program,
        "paused", "stopped" or "playing"; None means as in the settings.
        """
        machine, modes = self._machine, self._machine.modes
        if not modes.unstopped:
            return
        self._set(SafetyMode.PROTECTIVE_STOP)
        self._protected_at_s = machine.clock.now_s
        machine.journal.stop("protective_stop", reason)
        farthest = int(np.argmax(np.abs(machine.reference.q - machine.measurements.encoder_q)))
        machine.journal.tell(ErrorMessage, reason, code, 0 if code != DEVIATES else farthest if joint is None else joint - 1)
        if self._programs.current is not None:
            runtime = runtime or machine.settings.protective_runtime
            if runtime == "stopped":
                self._programs.stop(reason, kind="protective_stop", by="safety")
            else:
                machine.moves.interrupt()
                if runtime == "paused":
                    modes.runtime = Runtime.PAUSED
        machine.reference.stop(SAFETY_STOP_RAD_S2)

    def unlock(self, *, after_s: float = UNLOCK_AFTER_S) -> bool:
        """End a protective stop. Returns False if there is none, or it began less than `after_s` ago."""
        machine, modes = self._machine, self._machine.modes
        if modes.safety != SafetyMode.PROTECTIVE_STOP or machine.clock.now_s - self._protected_at_s < after_s:
            return False
        self._set(SafetyMode.NORMAL)
        machine.limits.reset(machine.measurements.encoder_q)
        self._hold_where_the_arm_is()
        if modes.runtime == Runtime.PLAYING:
            machine.moves.resume()
        return True

    def open_safeguard(self, seconds: float) -> None:
        """Halt the arm and pause its program, because somebody opened the guard; closed after this time, 0 s: by `close_safeguard`."""
        machine, modes = self._machine, self._machine.modes
        if not modes.unstopped:
            return
        self._set(SafetyMode.SAFEGUARD_STOP)
        machine.journal.stop("safeguard_stop", "the safeguard is open")
        self._resume_at_s = machine.clock.now_s + seconds if seconds > 0.0 else None
        self._resumes = modes.runtime == Runtime.PLAYING
        if self._resumes:
            machine.moves.interrupt()
            modes.runtime = Runtime.PAUSED
        machine.reference.stop(SAFETY_STOP_RAD_S2)

    def close_safeguard(self) -> None:
        """Go on by itself, as with an automatic reset: a program that the safeguard paused plays on."""
        machine, modes = self._machine, self._machine.modes
        self._resume_at_s = None
        if modes.safety != SafetyMode.SAFEGUARD_STOP:
            return
        self._set(SafetyMode.NORMAL)
        if self._resumes and modes.runtime == Runtime.PAUSED:
            modes.runtime = Runtime.PLAYING
            machine.moves.resume()

    def emergency_stop(self) -> None:
        """Halt the arm; the power goes off when it stands."""
        machine, modes = self._machine, self._machine.modes
        if modes.safety == SafetyMode.ROBOT_EMERGENCY_STOP:
            return
        self._programs.stop("emergency stop", kind="emergency_stop", by="safety")
        machine.journal.stop("emergency_stop", "the button was pressed")
        self._set(SafetyMode.ROBOT_EMERGENCY_STOP)
        machine.reference.stop(SAFETY_STOP_RAD_S2)

    def release_emergency_stop(self) -> None:
        """Pull the emergency stop button out again. The power stays off."""
        modes = self._machine.modes
        if modes.safety == SafetyMode.ROBOT_EMERGENCY_STOP:
            self.power_off()
            modes.safety = SafetyMode.NORMAL

    def power(self, mode: RobotMode) -> bool:
        """Do what "power on" (IDLE), "brake release" (RUNNING) or "power off" (POWER_OFF) asks; False if impossible.

        A brake release without power switches the power on first.
        """
        modes = self._machine.modes
        if mode == RobotMode.POWER_OFF:
            self._programs.stop("power off", by="power")
            self.power_off()
        elif modes.safety == SafetyMode.ROBOT_EMERGENCY_STOP:
            return False
        elif mode == RobotMode.RUNNING:
            if modes.robot == RobotMode.RUNNING:
                return True  # the brakes are open: a motion goes on
            self._machine.arm.powered = True
            self._hold_where_the_arm_is()
            modes.robot = RobotMode.RUNNING
        elif modes.robot == RobotMode.POWER_OFF:
            modes.robot = RobotMode.IDLE
            self._machine.arm.powered = True
        return True

    def lose_power(self) -> None:
        """The main switch is off: the brakes close, and the program is gone without a word."""
        self.power_off()
        self._machine.journal.logbook.cut()
        self._machine.modes.runtime = Runtime.STOPPED

    def _set(self, mode: SafetyMode) -> None:
        """Change the safety mode, and tell it."""
        self._machine.modes.safety = mode
        self._machine.journal.tell(SafetyMessage, mode)

    def power_off(self) -> None:
        """Close the brakes and switch the drives off."""
        arm = self._machine.arm
        arm.brake()
        arm.powered = False
        self._hold_where_the_arm_is()
        self._machine.modes.robot = RobotMode.POWER_OFF

    def _hold_where_the_arm_is(self) -> None:
        machine = self._machine
        machine.reference.reset(machine.measurements.encoder_q)
