"""Programs in URScript: what they do, and what is reported where they cannot go on."""

import itertools

import numpy as np
import pytest

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.journal import ErrorMessage, ExceptionMessage, ProgramMessage, SafetyMessage, TextMessage
from monitor.simulate.machine.state import Runtime, SafetyMode
from monitor.simulate.settings import SimulateSettings


def after(script: str, seconds: float = 1.0, **settings) -> Controller:
    """A controller some time after it was given a script."""
    controller = Controller(SimulateSettings(robot="ur5e", **settings))
    controller.step()
    controller.run_script(script)
    for _ in range(round(seconds / controller.clock.tick_s)):
        controller.step()
    return controller


def said(controller: Controller) -> list[str]:
    return [message.text for message in controller.journal.messages if isinstance(message, TextMessage)]


def exceptions(controller: Controller) -> list[ExceptionMessage]:
    return [message for message in controller.journal.messages if isinstance(message, ExceptionMessage)]


def test_a_program_computes_branches_and_calls_its_own_functions():
    """Variables, loops, branches, functions with defaults, lists and texts mean what they mean in URScript."""
    controller = after(
        "def sums():\n"
        "  global total = 0\n"
        "  def add(x, factor=2):\n"
        "    total = total + factor * x\n"
        "    return total\n"
        "  end\n"
        "  i = 0\n"
        '  while True:  # a comment with a "quote\n'
        "    i = i + 1\n"
        "    if i == 2:\n"
        "      continue\n"
        "    elif i > 4 or not True:\n"
        "      break\n"
        "    else:\n"
        "      add(i)\n"
        "    end\n"
        "  end\n"
        "  list = [1, 2, 3] * 2 + [0.5, 0.5, 0.5]\n"
        "  list[0] = norm([3, 4])\n"
        '  textmsg("sum ", add(1, factor=0))\n'
        '  textmsg(str_cat("list ",\n'
        "    to_str(list)))\n"
        "  textmsg(pose_trans(p[1,0,0,0,0,0], p[0,2,0,0,0,0]))\n"
        "end",
        0.02,
    )
    assert said(controller) == ["sum 16", "list [5,4.5,6.5]", "p[1,2,0,0,0,0]"]
    assert controller.modes.runtime == Runtime.STOPPED


def test_a_program_is_named_when_it_starts_and_when_it_ends():
    """The key messages carry the name in the script, and its texts come between them."""
    controller = after('def errand():\n  textmsg("on my way")\n  sleep(0.1)\n  sync()\nend', 0.5)
    messages = list(controller.journal.messages)
    assert [(type(message), getattr(message, "title", ""), message.text) for message in messages] == [
        (ProgramMessage, "PROGRAM_XXX_STARTED", "errand"),
        (TextMessage, "", "on my way"),
        (ProgramMessage, "PROGRAM_XXX_STOPPED", "errand"),
    ]
    assert messages[2].at_s - messages[0].at_s == pytest.approx(0.1, abs=0.007)  # three control periods more at most


def test_a_program_that_loops_runs_until_somebody_stops_it():
    """A loop with a sleep goes on; `stop program` ends it."""
    controller = after('def forever():\n  while True:\n    textmsg("tick")\n    sleep(0.1)\n  end\nend', 1.0)
    assert controller.modes.runtime == Runtime.PLAYING
    assert len(said(controller)) == pytest.approx(10, abs=1)
    controller.run_script("stop program")
    assert controller.modes.runtime == Runtime.STOPPED


def test_a_program_moves_the_arm_from_where_it_is():
    """Moves are made of computed figures, one after another."""
    controller = after(
        "def swing():\n  here = get_actual_joint_positions()\n  there = here + [0,0,0,0,0,0.3]\n"
        "  movej(there, a=4, v=2)\n  write_output_float_register(3, get_target_joint_positions()[5])\n  movej(here, a=4, v=2)\nend",
        2.0,
    )
    assert controller.registers.output_doubles[3] == pytest.approx(0.3, abs=1e-3)
    assert np.allclose(controller.reference.q, [0, -np.pi / 2, 0, -np.pi / 2, 0, 0], atol=1e-3)
    assert controller.journal.stops[-1].kind == "program_end"


@pytest.mark.parametrize(
    ("script", "text", "place"),
    [
        ("def bad():\n  no_such_function()\nend", "compile_error_name_not_found:no_such_function:", (2, 3)),
        ("no_such_function()", "compile_error_name_not_found:no_such_function:", (1, 1)),
        ("def bad():\n  textmsg(1)\n  x = 2 * nothing_here\nend", "compile_error_name_not_found:nothing_here:", (3, 11)),
        (
            "def bad():\n  force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,9,0,0,0], 2, [1,1,1,1,1,1])\nend",
            "not simulated: force_mode",
            (2, 3),
        ),
        ("def bad():\n  thread other(x):\n  end\nend", "a thread has none", (2, 1)),
        ("def bad():\n  t = run nobody()\nend", "name of a thread", (2, 6)),
        ("def bad():\n  if True:\n    force_mode(1)\n  end\nend", "not simulated: force_mode", (3, 5)),
        (
            "def bad():\n  thread away():\n    movej([0,-1,0,-1,0,0], a=1, v=1)\n  end\n"
            "  t = run away()\n  sleep(0.02)\n  movej([0,0,0,0,0,0])\nend",
            "another thread is already controlling the robot",
            (1, 1),
        ),
        ("def bad():\n  while 1 +:\n  end\nend", "syntax_error", (2, 1)),
        ("movej(p[10,0,0,0,0,0])", "movej: no joint positions", (1, 1)),
        ("def bad():\n  i = 0\n  while True:\n    i = i + 1\n  end\nend", "takes time", (3, 9)),
        ("def bad():\n  x = [1, 2]\n  textmsg(x[2])\nend", "index", (3, 3)),
        ('def bad():\n  x = 1 + "one"\nend', "a text is no number", (2, 7)),
        ("def bad():\n  x = [1]\n  while True:\n    x = [x, x]\n  end\nend", "lists within each other", (4, 9)),
        ('def bad():\n  x = "1234567890"\n  while True:\n    x = str_cat(x, x)\n  end\nend', "1023 characters", (4, 9)),
        ("def bad():\n  x = [1, 2]\n  x[0] = x\n  x[0] = x\n  x[0] = x\nend", "does not exist", (5, 10)),
        ("def bad():\n  def again():\n    again()\n  end\n  again()\nend", "too many calls", (3, 5)),
    ],
)
def test_a_program_that_cannot_go_on_is_reported_with_its_place(script, text, place):
    """Each ends with one runtime exception that says what, in which line and column. The arm does not move, and no program is left."""
    controller = after(script, 0.05)
    (message,) = exceptions(controller)
    assert text in message.text
    if text != "movej: no joint positions":
        assert (message.line, message.column) == place
    assert controller.programs.current is None
    assert np.all(controller.reference.qd == 0.0)


def test_a_protective_stop_of_a_program_is_reported_with_its_code_and_released_by_a_line():
    """Code 209 is a warning. The program goes on to its end; the line on the script port does not wait for five seconds."""
    controller = after("def alarm():\n  protective_stop()\nend", 0.05)
    kinds = [type(message) for message in controller.journal.messages]
    assert kinds == [ProgramMessage, SafetyMessage, ErrorMessage, ProgramMessage]
    assert controller.journal.messages[2].code == (209, 2)
    assert (controller.modes.safety, controller.modes.runtime) == (SafetyMode.PROTECTIVE_STOP, Runtime.STOPPED)
    controller.run_script("set unlock protective stop")
    assert controller.modes.safety == SafetyMode.NORMAL
    assert controller.journal.messages[-1] == SafetyMessage(controller.clock.now_s, SafetyMode.NORMAL)


def test_a_line_to_a_pose_out_of_reach_is_a_protective_stop():
    """A movej to the same pose is an exception; a movel stops the arm with a code."""
    controller = after("movel(p[10,0,0,0,0,0])", 0.05)
    assert controller.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert exceptions(controller) == []


def test_power_and_brakes_obey_lines_on_the_script_port():
    """`power off`, `power on`, and `set robotmode run` from any of both."""
    controller = Controller(SimulateSettings())
    modes = []
    for line in ("power off", "power on", "power on", "set robotmode run", "power off", "set robotmode run", "power on"):
        controller.run_script(line)
        modes.append(controller.modes.robot.name)
    assert modes == ["POWER_OFF", "IDLE", "IDLE", "RUNNING", "POWER_OFF", "RUNNING", "RUNNING"]


def test_a_secondary_program_declares_and_takes_no_time():
    """It acts at once beside the program that runs; a step that takes time is an exception, also behind a branch."""
    controller = after("def forever():\n  while True:\n    sync()\n  end\nend", 0.02)
    controller.run_script("sec setup():\n set_target_payload(1, [0.2, 0.3, 0.1] , [0.4, 0.7, 0.8, 0.2, 0.5, 0.6] , 0.002)\nend")
    controller.run_script("sec tool():\n set_tcp(p[0,0,0.1,0,0,0])\n set_standard_digital_out(2, True)\nend")
    assert controller.installation.payload == (1.0, 0.2, 0.3, 0.1)
    assert controller.installation.inertia_kg_m2 == (0.4, 0.7, 0.8, 0.2, 0.5, 0.6)
    assert (controller.kinematics.tool[2], controller.registers.outputs.digital) == (0.1, 4)
    controller.run_script("sec late():\n if True:\n  sleep(1)\n end\nend")
    assert "secondary" in exceptions(controller)[0].text
    assert controller.modes.runtime == Runtime.PLAYING


def test_a_program_pauses_and_goes_on_where_it_was():
    """Texts stop during a pause and go on after it."""
    controller = after("def forever():\n  i = 0\n  while True:\n    i = i + 1\n    textmsg(i)\n    sleep(0.1)\n  end\nend", 0.5)
    assert controller.programs.pause()
    before = len(said(controller))
    for _ in range(250):
        controller.step()
    assert len(said(controller)) == before
    assert controller.programs.play()
    for _ in range(250):
        controller.step()
    numbers = [int(text) for text in said(controller)]
    assert len(numbers) > before
    assert all(b == a + 1 for a, b in itertools.pairwise(numbers))


def test_threads_take_turns_and_share_global_variables():
    """A thread counts beside the main one until it is killed; `join` waits for another one; a thread's own variables are its own."""
    controller = after(
        "def beside():\n"
        "  global count = 0\n"
        "  global done = 0\n"
        "  thread counting():\n"
        "    mine = 100\n"
        "    while True:\n"
        "      count = count + 1\n"
        "      sync()\n"
        "    end\n"
        "  end\n"
        "  thread short():\n"
        "    sleep(0.1)\n"
        "    done = 1\n"
        "  end\n"
        "  async = run counting()\n"  # a keyword of Python is an ordinary name
        "  sleep(0.2)\n"
        "  kill async\n"
        "  first = count\n"
        "  other = run short()\n"
        "  join other\n"
        '  textmsg("counted ", first > 5 and count == first)\n'
        '  textmsg("done ", done)\n'
        "  kill 0\n"
        "  textmsg(mine)\n"
        "end",
        1.0,
    )
    assert said(controller) == ["counted True", "done 1"]
    assert "name_not_found:mine" in exceptions(controller)[0].text


def test_no_other_thread_runs_in_a_critical_section():
    """The main thread sleeps within the section; the other one goes on behind it."""
    controller = after(
        "def alone():\n"
        "  global count = 0\n"
        "  thread counting():\n    while True:\n      count = count + 1\n      sync()\n    end\n  end\n"
        "  t = run counting()\n"
        "  sync()\n"
        "  enter_critical\n  before = count\n  sleep(0.1)\n  textmsg(count - before)\n  exit_critical\n"
        "  sleep(0.1)\n  textmsg(count - before > 5)\n"
        "end"
    )
    assert said(controller) == ["0", "True"]


def test_a_thread_streams_targets_and_the_arm_stops_when_it_is_killed():
    """servoj in a thread follows a global target, as the scripts of streaming clients do."""
    controller = after(
        "def stream():\n"
        "  global target = get_actual_joint_positions()\n"
        "  thread servo():\n    while True:\n      servoj(target, t=0.008, lookahead_time=0.05, gain=300)\n    end\n  end\n"
        "  t = run servo()\n"
        "  i = 0\n"
        "  while i < 100:\n    target[0] = target[0] + 0.002\n    i = i + 1\n    sync()\n  end\n"
        "  kill t\n"
        "  stopj(10)\n"
        "  write_output_float_register(0, get_target_joint_positions()[0])\n"
        "end",
        2.0,
    )
    way = 0.2 + 1.0**2 / (2 * 10)  # 100 targets of 2 mrad at 1 rad/s, and the way of the stop
    assert controller.registers.output_doubles[0] == pytest.approx(way, abs=0.03)
    assert controller.journal.stops[-1].kind == "program_end"
    assert np.all(controller.reference.qd == 0.0)


@pytest.mark.parametrize(("action", "runtime"), [("stop", Runtime.STOPPED), ("pause", Runtime.PAUSED), ("ignore", Runtime.PLAYING)])
def test_a_watchdog_does_what_its_program_asked_for(action, runtime):
    """It expires without packets; `ignore` ends a watch that was begun before."""
    watched = f'  rtde_set_watchdog("input_int_register_0", 10.0, "stop")\n  rtde_set_watchdog("input_int_register_0", 10.0, "{action}")\n'
    controller = after(f"def watched():\n{watched}  while True:\n    sync()\n  end\nend", 0.5)
    assert controller.modes.runtime == runtime
