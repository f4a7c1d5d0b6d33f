"""Scripts are cut out of any stream of bytes. A script that is not understood is refused with a reason."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim_pendant import CONTROL

from monitor.simulate.machine.moves import Move, StopMotion
from monitor.simulate.polyscope import Version
from monitor.simulate.program.interpreter import run
from monitor.simulate.program.language import Source
from monitor.simulate.program.scripts import SCRIPT_MAX_BYTES, ControlScript, Framer, Immediate, Refused, parse
from monitor.simulate.program.steps import PathProgress, Step, Wait, Write


def steps(text: str) -> list[Step]:
    """The steps of a program that does not ask for the state of the arm."""
    program = parse(text)
    assert isinstance(program, Source), program
    return list(run(program, None))


@given(cuts=st.lists(st.integers(0, len(CONTROL) + 40), max_size=12))
def test_a_script_is_whole_however_it_is_cut(cuts):
    """Only an `end` in column 0 ends a script; nested ones are indented. Lines before and after are scripts of their own."""
    stream = ("stop program\n" + CONTROL + "halt\n").encode()
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    framer = Framer()
    scripts = [text for a, b in itertools.pairwise(edges) for text in framer.feed(stream[a:b])]
    assert scripts == ["stop program", CONTROL.rstrip("\n"), "halt"]


def test_the_control_script_is_recognised_with_its_offsets():
    """ur-rtde writes the offsets 0 and 24 behind the comment. Other offsets are refused."""
    assert parse(CONTROL.rstrip()) == ControlScript(0, 0)
    assert parse(CONTROL.replace("offset\n0", "offset\n24")) == ControlScript(24, 24)
    assert isinstance(parse(CONTROL.replace("offset\n0", "offset\n7")), Refused)


TORQUE = "direct_torque([0,0,0,0,0,0], viscous_scale=[0,0,0,0,0,0])"


@pytest.mark.parametrize(
    ("call", "unknown", "before", "since"),
    [
        ("direct_torque([0,0,0,0,0,0])", "direct_torque", (3, 5, 22), (5, 23, 0)),
        ("direct_torque([0,0,0,0,0,0])", "direct_torque", (3, 15, 8), (10, 11, 0)),
        (TORQUE, "viscous_scale", (5, 25, 0), (5, 25, 1)),
        (TORQUE, "viscous_scale", (10, 11, 0), (10, 12, 1)),
        (TORQUE, "viscous_scale", (10, 12, 0), (10, 13, 0)),
        ("ft_rtde_input_enable(False, 0, [0,0,0], [0,0,0])", "ft_rtde_input_enable", (5, 9, 0), (5, 9, 1)),
        ("ft_rtde_input_enable(False, 0, [0,0,0], [0,0,0])", "ft_rtde_input_enable", (3, 14, 0), (3, 14, 1)),
        ("set_target_payload(0, [0,0,0], [0,0,0,0,0,0])", "set_target_payload", (3, 15, 8), (5, 10, 0)),
        ("optimovej([0,0,0,0,0,0])", "optimovej", (5, 20, 0), (10, 12, 0)),
        ('textmsg(str_cat("a", "b"))', "str_cat", (3, 7, 9), (3, 8, 0)),
    ],
)
def test_a_name_that_a_version_does_not_know_refuses_the_whole_program(call, unknown, before, since):
    """Where it stands in a branch that is never taken, and in ur-rtde's own program. One of the program's own, or in a comment, is none."""
    before, since = Version(*before, *(0,) * (4 - len(before))), Version(*since, 0)
    for text in (
        f"def mine():\n  x = 1\n  if x == 2:\n    {call}\n  end\nend",
        CONTROL.replace("        # inject", f"        {call}\n# inject"),
    ):
        line = 1 + text[: text.index(call)].count("\n")
        refused = parse(text, version=before)
        assert isinstance(refused, Refused), text
        assert refused.report == f"compile_error_name_not_found:{unknown}:"
        assert (refused.line, text.split("\n")[line - 1][refused.column - 1 :].startswith(unknown)) == (line, True)
        assert not isinstance(parse(text, version=since), Refused)
        assert not isinstance(parse(text.replace(call, f"sync() # {call}"), version=before), Refused)
    name = call.split("(")[0]
    own = f"def mine():\n  def {name}(a, viscous_scale=0):\n    return a\n  end\n  x = {name}(1, viscous_scale=2)\nend"
    assert isinstance(parse(own, version=before), Source)


def test_an_injected_path_is_a_list_of_steps():
    """A path as ur-rtde writes it. A move that is not simulated refuses the whole script with its name."""
    lines = "signal_async_progress(0)\nmovej([0,0,0,0,0,0],a=1.4,v=1,r=0)\nmovel(p[0.3,0,0.2,0,3,0],a=1.2,v=0.25,r=0.01)\n"
    path = parse(CONTROL.replace("# inject move path\n", "# inject move path\n" + lines))
    joint = Move((0.0,) * 6, pose=False, straight=False, speed=1.0, acceleration=1.4)
    tool = Move((0.3, 0.0, 0.2, 0.0, 3.0, 0.0), pose=True, straight=True, speed=0.25, acceleration=1.2)
    assert path == ControlScript(0, 0, (PathProgress(0), joint, tool))
    circle = parse(CONTROL.replace("# inject move path\n", "# inject move path\nmovec(p[0,0,0,0,0,0], p[1,0,0,0,0,0])\n"))
    assert isinstance(circle, Refused)
    assert "movec" in circle.reason


def test_a_program_that_is_a_list_of_steps_and_one_that_is_not():
    """ur-rtde's custom script functions are lists of steps. A mode that is not simulated, an endless loop or a wrong figure is refused."""
    custom = "def mine():\n\twrite_output_integer_register(0 +24, 1)\n\tsleep(0.5)\n\tstopj(2)\n\twrite_output_float_register(3, 1.5)\nend"
    assert steps(custom) == [Write(24, 1.0, whole=True), Wait(0.5), StopMotion(2.0), Write(3, 1.5, whole=False)]
    for body in ("force_mode(1)", "while True:", "x 1", "write_output_integer_register(99, 1)", "sleep(1e999)"):
        foreign = parse(f"def custom():\n  {body}\nend")
        assert isinstance(foreign, Refused), body
        assert "custom" in foreign.reason


def test_single_lines_are_understood_or_refused():
    """movej, movel, stops and immediate commands are understood, and other lines are refused."""

    def joints(q, speed, acceleration):
        return [Move(tuple(map(float, q)), pose=False, straight=False, speed=speed, acceleration=acceleration)]

    assert steps("movej([0, -1.5, 0, -1.5, 0, 0.5], a=1.2, v=0.5)") == joints((0, -1.5, 0, -1.5, 0, 0.5), 0.5, 1.2)
    assert steps("movej([0,0,0,0,0,0], 2, 1)") == joints([0] * 6, 1.0, 2.0)
    assert steps("movej(p[0,0,0,0,0,0])") == [Move((0.0,) * 6, pose=True, straight=False, speed=1.05, acceleration=1.4)]
    assert steps("stopj(3.0)") == [StopMotion(3.0)]
    assert parse("stop program") == Immediate("stop program")
    for line in (
        "movej([1e999,0,0,0,0,0])",
        "movej([0,0,0,0,0,0], v=-1)",
        "movel([0])",
        "import os",
        "movej(",
        "movej()",
        "exec('1')",
        "movej([0,0,0,0,0,0], t=2)",
    ):
        assert isinstance(parse(line), Refused), line


def test_an_unending_script_is_dropped():
    """After a megabyte without an end the script is refused, and the next script is read."""
    framer = Framer()
    complete = framer.feed(b"def endless():\n" + b"  x = 1\n" * (SCRIPT_MAX_BYTES // 8 + 1))
    assert len(complete) == 1
    assert isinstance(parse(complete[0]), Refused)
    assert framer.feed(b"halt\n") == ["halt"]


@given(junk=st.binary(max_size=600))
def test_junk_is_refused(junk):
    """Arbitrary bytes raise no exception and are never taken for a control script."""
    for text in Framer().feed(junk + b"\n"):
        assert not isinstance(parse(text), ControlScript)
