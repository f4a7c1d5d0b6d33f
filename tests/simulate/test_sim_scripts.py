"""Scripts are cut out of any stream of bytes, and what is not understood is refused by name."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from monitor.simulate.scripts import SCRIPT_MAX_BYTES, ControlScript, Framer, Immediate, MoveJ, Refused, StopJ, parse

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


@given(cuts=st.lists(st.integers(0, len(CONTROL) + 40), max_size=12))
def test_a_script_is_whole_however_it_is_cut(cuts):
    """Nested `end`s are indented; only the one in column 0 ends it. Lines before and after stand alone."""
    stream = ("stop program\n" + CONTROL + "halt\n").encode()
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    framer = Framer()
    scripts = [text for a, b in itertools.pairwise(edges) for text in framer.feed(stream[a:b])]
    assert scripts == ["stop program", CONTROL.rstrip("\n"), "halt"]


def test_the_control_script_is_recognised_with_its_offsets():
    """0 and 24, as ur-rtde writes them behind the comment; other offsets are refused."""
    assert parse(CONTROL.rstrip()) == ControlScript(0, 0)
    assert parse(CONTROL.replace("offset\n0", "offset\n24")) == ControlScript(24, 24)
    assert isinstance(parse(CONTROL.replace("offset\n0", "offset\n7")), Refused)


def test_an_injected_path_and_a_foreign_program_are_refused_by_name():
    """They are not interpreted: better no motion than a wrong one."""
    path = parse(CONTROL.replace("# inject move path\n", "# inject move path\nmovej([0,0,0,0,0,0],a=1,v=1)\n"))
    assert isinstance(path, Refused)
    assert "path" in path.reason
    foreign = parse("def custom():\n  popup(1)\nend")
    assert isinstance(foreign, Refused)
    assert "custom" in foreign.reason


def test_single_lines():
    """movej with positions and names, stopj, immediate commands; the rest refused."""
    assert parse("movej([0, -1.5, 0, -1.5, 0, 0.5], a=1.2, v=0.5)") == MoveJ((0.0, -1.5, 0.0, -1.5, 0.0, 0.5), speed=0.5, acceleration=1.2)
    assert parse("movej([0,0,0,0,0,0], 2, 1)") == MoveJ((0.0,) * 6, speed=1.0, acceleration=2.0)
    assert parse("stopj(3.0)") == StopJ(3.0)
    assert parse("stop program") == Immediate("stop program")
    for line in ("movej(p[0,0,0,0,0,0])", "movej([1e999,0,0,0,0,0])", "movej([0,0,0,0,0,0], v=-1)", "movel([0])", "import os", "movej("):
        assert isinstance(parse(line), Refused), line


def test_an_unending_script_is_dropped():
    """A megabyte without an end: told, and the next script is heard."""
    framer = Framer()
    told = framer.feed(b"def endless():\n" + b"  x = 1\n" * (SCRIPT_MAX_BYTES // 8 + 1))
    assert len(told) == 1
    assert isinstance(parse(told[0]), Refused)
    assert framer.feed(b"halt\n") == ["halt"]


@given(junk=st.binary(max_size=600))
def test_junk_is_refused(junk):
    """Any bytes: nothing raises, nothing of it becomes a control script."""
    for text in Framer().feed(junk + b"\n"):
        assert not isinstance(parse(text), ControlScript)
