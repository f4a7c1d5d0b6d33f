"""A controller without sockets that a test drives as ur-rtde does: it writes registers, computes control periods and reads registers."""

import numpy as np

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.registers import INPUT_TYPES, recipe
from monitor.simulate.machine.state import RobotMode, Runtime
from monitor.simulate.settings import SimulateSettings

CONTROL = """def rtde_control():
    global reg_offset_float = # float register offset
0
    global reg_offset_int = # int register offset
0
    def exec_move_path():
        # inject move path
    end
    # NODE_CONTROL_LOOP_BEGINS
    while keep_running:
        sync()
    end
end
"""


DOUBLES = [f"input_double_register_{i}" for i in range(11)]
COMMAND = recipe(["input_int_register_0"], INPUT_TYPES)
SERVO = recipe(["input_int_register_0", *DOUBLES], INPUT_TYPES)
MOVE = recipe(["input_int_register_0", *DOUBLES[:8], "input_int_register_1"], INPUT_TYPES)
ONE = recipe(["input_int_register_0", DOUBLES[0]], INPUT_TYPES)
CLEAR = (COMMAND, [0])
SIX = recipe(["input_int_register_0", *DOUBLES[:6]], INPUT_TYPES)
FOUR = recipe(["input_int_register_0", *DOUBLES[:4]], INPUT_TYPES)
FOURTEEN = recipe(["input_int_register_0", *[f"input_double_register_{i}" for i in range(14)]], INPUT_TYPES)
SPEED = recipe(["input_int_register_0", *DOUBLES[:8]], INPUT_TYPES)


class Pendant:
    """Runs ur-rtde's control script on a controller and writes its registers."""

    def __init__(self, *, before: Controller | None = None, **settings) -> None:
        """On a new arm, or on that of a controller that was killed, with its power switched on again."""
        self.controller = Controller(SimulateSettings(**settings), before=before)
        if before is not None:
            self.controller.safety.power(RobotMode.IDLE)
            self.controller.safety.power(RobotMode.RUNNING)
        self.controller.step()
        self.controller.run_script(CONTROL.rstrip())

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.controller.clock.tick_s)):
            self.controller.step()

    def do(self, written, values, within_s: float = 20.0) -> int:
        """Give a blocking command, wait until it is done, and clear it. Returns output integer 1, or −1 if the command was never done."""
        c = self.controller
        c.write_inputs(written, values)
        until = c.clock.now_s + within_s
        while c.registers.output_ints[0] != 2 and c.clock.now_s < until and c.modes.runtime == Runtime.PLAYING:
            c.step()
        result = c.registers.output_ints[1] if c.registers.output_ints[0] == 2 else -1
        c.write_inputs(*CLEAR)
        c.step()
        return result

    def servo(self, q) -> None:
        self.controller.write_inputs(SERVO, [11, *q, 0, 0, 0.008, 0.03, 500])

    def stream(self, seconds: float, speed: float = 1.0) -> None:
        """Send servoj targets at 125 Hz: after a soft start, all joints move at a constant speed."""
        c = self.controller
        q = c.reference.q.copy()
        v = 0.0
        for _ in range(round(seconds / 0.008)):
            v = min(speed, v + 0.05)
            q = q + 0.008 * v
            self.servo(q)
            for _ in range(round(0.008 / c.clock.tick_s)):
                c.step()

    @property
    def standing(self) -> bool:
        return self.controller.reference.at_rest and np.abs(self.controller.arm.qd).max() < 0.01
