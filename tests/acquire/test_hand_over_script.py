"""The node at which a production program hands the arm over, executed as URScript on the simulated controller."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.acquire.hand_over.script import (
    ASTRAY,
    BEAT,
    DUE,
    IDLE,
    LOST,
    OFFER,
    STATE,
    TAKE,
    TAKEN,
    HandOverSettings,
    hand_over_script,
)
from monitor.acquire.hand_over.settings import HandOver
from monitor.errors import BadInput
from monitor.simulate.controller.controller import Controller
from monitor.simulate.controller.journal import TextMessage
from monitor.simulate.controller.modes import Runtime
from monitor.simulate.program_tree import load_tree
from monitor.simulate.settings import SimulateSettings

THREADS = ("servo", "servoc", "speed", "move", "stop", "force", "jog", "contact")
CONTROL = (  # the shape of ur-rtde's text with one command: 11 streams targets of joint 1, relative to where the arm stands
    "# HEADER_BEGIN\n    global reg_offset_float = # float register offset\n"
    "0    global reg_offset_int = # int register offset\n0\n"
    + "".join(f"    global {name}_thrd = 0\n" for name in THREADS)
    + "".join(f"    global {name} = 0\n" for name in ("is_servoing", "is_speeding", "is_in_forcemode", "internal_cmd"))
    + "    global target = [0, 0, 0, 0, 0, 0]\n"
    "    thread servo_thread():\n        while (True):\n"
    "            servoj(target, t=0.002, lookahead_time=0.03, gain=500)\n        end\n    end\n"
    "    def rtde_cmd():\n        return read_input_integer_register(0)\n    end\n"
    "    def process_cmd(cmd):\n        if cmd == 11:\n"
    "            target = jm_taken_q + [read_input_float_register(0), 0, 0, 0, 0, 0]\n"
    "            if servo_thrd == 0:\n                servo_thrd = run servo_thread()\n            end\n        end\n"
    "        return cmd != 255\n    end\n# HEADER_END\n# NODE_CONTROL_LOOP_BEGINS\n"
    "    keep_running = True\n    write_output_integer_register(0, 1)\n"
    "    while keep_running:\n        cmd = rtde_cmd()\n        keep_running = process_cmd(cmd)\n        sync()\n    end\n"
    "# NODE_CONTROL_LOOP_ENDS\n"
)


class Cell:
    """A controller whose program hands the arm over between two messages, and the monitor's side of the registers."""

    def __init__(self, folder: Path, **settings: float) -> None:
        file = folder / "cell.toml"
        nodes = ('message = "before"', 'external_control = "127.0.0.1"', 'message = "after"', "wait = 0.02")
        file.write_text('name = "cell"\n' + "".join(f"[[node]]\n{node}\n" for node in nodes))
        tree = load_tree(file)
        self.controller = Controller(SimulateSettings(robot="ur5e", program=tree))
        self.controller.step()
        text = hand_over_script(CONTROL, HandOverSettings(**settings))
        self.controller.programs.files.serve({tree.hosts[0]: text})
        assert self.controller.programs.play()
        self.beating = True

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.controller.clock.tick_s)):
            if self.beating:
                self.write(BEAT, (self.inputs[BEAT] + 1) % 1000)
            self.controller.step()

    @property
    def inputs(self) -> list[int]:
        return self.controller.registers.inputs.ints

    def write(self, register: int, value: int) -> None:
        self.inputs[register] = value

    def output(self, register: int) -> int:
        return self.controller.registers.output_ints[register]

    def stream(self, offset_rad: float, seconds: float) -> None:
        """Move joint 1 so far at 1 rad/s, and hold, until the time is over."""
        tick_s = self.controller.clock.tick_s
        self.write(0, 11)
        for i in range(round(seconds / tick_s)):
            self.controller.registers.inputs.doubles[0] = min(offset_rad, i * tick_s)
            self.run(tick_s)

    @property
    def texts(self) -> list[str]:
        return [message.text for message in self.controller.journal.messages if isinstance(message, TextMessage)]

    def until(self, state: int, within_s: float = 1.0) -> float:
        """Run until the node is in this state. Returns how long that took [s]."""
        begin = self.controller.clock.now_s
        while self.output(STATE) != state:
            assert self.controller.clock.now_s - begin < within_s, self.texts
            self.run(self.controller.clock.tick_s)
        return self.controller.clock.now_s - begin

    def take(self) -> None:
        self.write(DUE, 1)
        self.until(1)
        self.write(TAKE, self.output(OFFER))
        self.until(TAKEN)


def test_a_node_costs_nothing_when_no_replay_is_due(tmp_path):
    """The program goes round in its own time; the node adds no control period that the program could notice."""
    cell = Cell(tmp_path)
    cell.run(1.0)
    assert cell.texts.count("after") >= 30  # of 0.02 s each
    assert cell.output(OFFER) >= 30


@pytest.mark.parametrize("beating", [True, False])
def test_a_node_that_nobody_takes_goes_on_within_a_tenth_of_a_second(tmp_path, beating):
    """Also where the registers still say that a replay is due and name a number, because the monitor died."""
    cell = Cell(tmp_path)
    cell.beating = beating
    cell.write(DUE, 1)
    for number in range(1, 6):
        cell.write(TAKE, 0 if beating else number)  # a number that happens to be right is not believed without a beat
        cell.run(0.12)
    assert 4 <= cell.texts.count("after") <= 6
    assert cell.output(STATE) != TAKEN
    assert np.all(cell.controller.reference.qd == 0.0)


def test_a_replay_in_between_is_followed_by_the_next_node(tmp_path):
    """The arm moves and comes back; nothing of the loop stays behind: no thread, no watchdog, no `ready`."""
    cell = Cell(tmp_path)
    cell.take()
    before = cell.controller.reference.q.copy()
    cell.stream(0.2, 0.3)
    assert cell.controller.reference.q[0] - before[0] > 0.1
    for offset in np.linspace(0.2, 0.0, 200):
        cell.controller.registers.inputs.doubles[0] = float(offset)
        cell.run(0.002)
    cell.run(0.5)
    assert cell.output(0) == 1
    done = cell.texts.count("after")
    cell.write(0, 0)
    cell.write(DUE, 0)
    cell.write(TAKE, 0)
    took_s = cell.until(IDLE)
    assert took_s < 0.05
    cell.run(0.5)
    assert cell.texts.count("after") > done + 10
    assert cell.output(0) == 0
    assert cell.controller.machine.watchdog.variable is None
    assert np.allclose(cell.controller.reference.q, before, atol=1e-3)


def test_a_minute_after_a_good_hand_back_the_program_still_plays(tmp_path):
    """The withdrawal of the number may come late, as long as the beat goes on: the arm stands, and nothing is left that stops it later."""
    cell = Cell(tmp_path)
    cell.take()
    cell.stream(0.1, 0.3)
    for offset in np.linspace(0.1, 0.0, 200):
        cell.controller.registers.inputs.doubles[0] = float(offset)
        cell.run(0.002)
    cell.run(1.6)
    offered = cell.output(OFFER)
    cell.write(0, 0)
    cell.write(DUE, 0)
    cell.write(TAKE, 0)
    cell.until(IDLE)
    cell.beating = False  # the monitor has gone
    cell.run(60.0)
    assert cell.controller.modes.runtime == Runtime.PLAYING
    assert not cell.controller.journal.stops
    assert cell.output(OFFER) > offered + 1000


@settings(max_examples=8, deadline=None)
@given(offset=st.floats(0.0, 0.3), moment_s=st.floats(0.0, 0.6))
def test_without_a_beat_the_arm_stops_and_no_node_follows(tmp_path_factory, offset, moment_s):
    """Whenever the monitor dies: the arm stands within a quarter of a second, and the program has ended."""
    cell = Cell(tmp_path_factory.mktemp("cell"))
    cell.take()
    after = cell.texts.count("after")
    cell.stream(offset, moment_s)
    cell.beating = False
    cell.run(0.25)
    assert np.all(cell.controller.reference.qd == 0.0)
    assert cell.controller.modes.runtime == Runtime.STOPPED
    assert cell.output(STATE) == LOST
    cell.beating = True  # the monitor comes back: nothing begins again
    cell.run(0.3)
    assert cell.texts.count("after") == after
    assert cell.controller.modes.runtime == Runtime.STOPPED


@settings(max_examples=5, deadline=None)
@given(offset=st.floats(0.0013, 0.2))
def test_an_arm_that_is_not_where_it_was_taken_is_not_given_back(tmp_path_factory, offset):
    """The program ends and says why. The next node is never reached."""
    cell = Cell(tmp_path_factory.mktemp("cell"))
    cell.take()
    after = cell.texts.count("after")
    cell.stream(offset, 0.5)
    cell.write(0, 0)
    cell.write(TAKE, 0)
    cell.until(ASTRAY)
    cell.run(0.5)
    assert cell.controller.modes.runtime == Runtime.STOPPED
    assert cell.texts.count("after") == after
    assert any("not where it was taken" in text for text in cell.texts)


def test_a_number_is_offered_once(tmp_path):
    """A node that is reached again has another number: what was said about the last one is not believed."""
    cell = Cell(tmp_path)
    cell.take()
    first = cell.output(OFFER)
    cell.write(TAKE, 0)
    cell.until(IDLE)
    cell.write(TAKE, first)
    cell.run(0.3)
    assert cell.output(STATE) != TAKEN
    assert cell.output(OFFER) > first


def test_a_text_that_is_not_ur_rtdes_is_refused():
    """The message says what is missing."""
    with pytest.raises(BadInput, match="HEADER_BEGIN"):
        hand_over_script("def rtde_control():\nend\n")
    with pytest.raises(BadInput, match="reads its command"):
        hand_over_script(CONTROL.replace("cmd = rtde_cmd()", "cmd = 0"))
    with pytest.raises(BadInput, match="registers"):
        hand_over_script(CONTROL.replace("# int register offset\n0", "# int register offset\n7"))
    with pytest.raises(BadInput, match="silence_s"):
        HandOverSettings(silence_s=5.0)


@pytest.mark.parametrize("listen", ["0.0.0.0", "0.0.0.0:", "0.0.0.0:0", "0.0.0.0:65536", "0.0.0.0:5²", "cell:50002", "0.0.0.0:-1"])
def test_an_address_to_listen_on_that_is_none_is_a_clear_error(listen):
    """Also a port in digits that are no number."""
    with pytest.raises(BadInput, match=r"hand_over_listen = .*expected an IPv4 address of this host and a port"):
        HandOver.of("external_control", listen, 1.0)
