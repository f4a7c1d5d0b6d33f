"""The node at which a production program hands the arm over, executed as URScript on the simulated controller."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from monitor.acquire.settings import HandOver
from monitor.acquire.ur.node_script import (
    ASTRAY,
    BEAT,
    DUE,
    IDLE,
    LOST,
    OFFER,
    STATE,
    TAKE,
    TAKEN,
    VERSION,
    hand_over_script,
)
from monitor.errors import BadInput
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.journal import ExceptionMessage, TextMessage
from monitor.simulate.machine.state import Runtime
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


NODES = ('message = "before"', 'external_control = "127.0.0.1"', 'message = "after"', "wait = 0.02")


class Cell:
    """A controller whose program hands the arm over between two messages, and the monitor's side of the registers."""

    def __init__(self, folder: Path, nodes: tuple[str, ...] = NODES) -> None:
        file = folder / "cell.toml"
        file.write_text('name = "cell"\n' + "".join(f"[[node]]\n{node}\n" for node in nodes))
        tree = load_tree(file)
        self.controller = Controller(SimulateSettings(robot="ur5e", program=tree))
        self.controller.step()
        text = hand_over_script(CONTROL)
        self.controller.programs.files.serve(dict.fromkeys(tree.hosts, text))
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
    assert 4 <= cell.texts.count("after") <= (6 if beating else 30)
    assert cell.output(STATE) != TAKEN
    assert np.all(cell.controller.reference.qd == 0.0)


def test_what_a_dead_monitor_has_left_costs_the_program_one_wait_and_no_second(tmp_path):
    """It was killed while a replay was due, and its word stands in the register for weeks; the next monitor is waited for as ever."""
    cell = Cell(tmp_path)
    cell.write(DUE, 1)
    cell.run(0.5)
    cell.beating = False
    cell.run(0.2)
    done, begin = cell.texts.count("after"), cell.controller.clock.now_s
    cell.run(2.0)
    each_s = (cell.controller.clock.now_s - begin) / (cell.texts.count("after") - done)
    assert each_s < 0.03  # 0.02 s of it are the program's own
    cell.beating = True
    cell.take()
    cell.write(TAKE, 0)
    cell.until(IDLE)


def test_the_program_says_which_text_it_has(tmp_path):
    """At Play, and in each round of a Script node; whoever looks compares it with the text of today."""
    (tmp_path / "lend.script").write_text(hand_over_script(CONTROL, version=4711))
    cell = Cell(tmp_path, nodes=('script = "lend.script"', "wait = 0.02"))
    cell.run(0.1)
    assert cell.output(VERSION) == 4711


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


@pytest.mark.soak
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
@example(offset=0.3, moment_s=0.15)  # in full motion
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
    assert any("contact lost" in text for text in cell.texts)  # by its own stop, although the last target still stands in its register
    assert not [message for message in cell.controller.journal.messages if isinstance(message, ExceptionMessage)]
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


@pytest.mark.parametrize("moment", range(16))
def test_an_arm_that_passes_where_it_was_taken_is_not_given_back(tmp_path, moment):
    """The number is withdrawn in mid-motion: the program goes on only with an arm that stands there."""
    cell = Cell(tmp_path)
    cell.take()
    taken = cell.controller.reference.q.copy()
    cell.stream(0.02, 0.3)
    after = cell.texts.count("after")
    for i in range(moment + 20):  # 0.2 rad/s back, and past it
        cell.controller.registers.inputs.doubles[0] = 0.02 - 0.0004 * 2 * i
        cell.run(0.002)
    cell.write(0, 0)
    cell.write(TAKE, 0)
    for _ in range(100):
        cell.run(cell.controller.clock.tick_s)
        if cell.texts.count("after") > after:
            assert np.all(cell.controller.reference.qd == 0.0)
            assert np.allclose(cell.controller.reference.q, taken, atol=1e-3)
            return
    assert cell.output(STATE) == ASTRAY
    assert cell.controller.modes.runtime == Runtime.STOPPED


def test_a_command_that_stands_in_its_register_takes_no_arm(tmp_path):
    """What another client left there would move the arm before the monitor has said a word."""
    cell = Cell(tmp_path)
    cell.write(0, 11)
    cell.controller.registers.inputs.doubles[0] = 0.3
    cell.write(DUE, 1)
    cell.until(1)
    before = cell.controller.reference.q.copy()
    cell.write(TAKE, cell.output(OFFER))
    done = cell.texts.count("after")
    cell.run(0.5)
    assert np.array_equal(cell.controller.reference.q, before)
    assert cell.texts.count("after") > done


def test_the_variables_of_the_program_are_its_own(tmp_path):
    """The program has names that ur-rtde's text has as well; a replay in between leaves their values."""
    (tmp_path / "own.script").write_text("global target = 5\nglobal keep_running = 7\nglobal cmd = 9\n")
    (tmp_path / "lend.script").write_text(hand_over_script(CONTROL))
    (tmp_path / "says.script").write_text('textmsg("values ", target * 100 + keep_running * 10 + cmd)\n')
    cell = Cell(tmp_path, nodes=('script = "own.script"', 'script = "lend.script"', 'script = "says.script"', "wait = 0.02"))
    cell.run(0.2)
    cell.take()
    cell.stream(0.1, 0.2)
    cell.stream(0.0, 0.5)
    cell.write(0, 0)
    cell.write(DUE, 0)
    cell.write(TAKE, 0)
    cell.until(IDLE)
    cell.run(0.2)
    assert len(cell.texts) > 10
    assert {text for text in cell.texts if "values" in text} == {"values 579"}


def test_every_name_of_the_text_is_the_nodes_own():
    """Keywords of calls, poses and what stands in comments and texts stay; a parameter named p is none of them."""
    text = hand_over_script(
        CONTROL.replace(
            "    def rtde_cmd():",
            "    def scaled(p, factor):\n        p[0] = p[0] * factor # p and factor\n"
            '        textmsg("factor: ", factor)\n        gain = 3\n'
            "        servoj(p, t=0.1, gain=gain)\n        return p[p[0], 0, 0, 0, 0, 0]\n    end\n    def rtde_cmd():",
        )
    )
    assert "def jm_scaled(jm_p, jm_factor):" in text
    assert "jm_p[0] = jm_p[0] * jm_factor # p and factor" in text
    assert 'textmsg("factor: ", jm_factor)' in text
    assert "servoj(jm_p, t=0.1, gain=jm_gain)" in text
    assert "return p[jm_p[0], 0, 0, 0, 0, 0]" in text
    with pytest.raises(BadInput, match="leaving"):
        hand_over_script(CONTROL.replace("    global is_servoing", "    global leaving = 0\n    global is_servoing"))


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


@pytest.mark.parametrize("listen", ["0.0.0.0", "0.0.0.0:", "0.0.0.0:0", "0.0.0.0:65536", "0.0.0.0:5²", "cell:50002", "0.0.0.0:-1"])
def test_an_address_to_listen_on_that_is_none_is_a_clear_error(listen):
    """Also a port in digits that are no number."""
    with pytest.raises(BadInput, match=r"hand_over_listen = .*expected an IPv4 address of this host and a port"):
        HandOver.of("external_control", listen, 1.0)
