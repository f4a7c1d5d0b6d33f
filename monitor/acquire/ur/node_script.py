"""The URScript of the node at which a production program hands the arm over.

The node offers the arm with a new number. If the monitor has said beforehand that a replay is due, and repeats the number within
`wait_s`, the arm is its own: ur-rtde's control loop runs until the monitor withdraws the number. The heartbeat is a register that the
monitor changes; without a change for `silence_s` the arm stops and the program ends. Before the first command, while the arm still
stands as it was taken, the monitor may be silent for `standing_s`. The program goes on at its next node only where the arm stands
within `near_rad` of where it was taken; anywhere else it ends. Nothing of the loop stays behind: threads are ended, the watchdog ignores
its input, and output register 0 no longer says "ready". Every name of the text begins with `jm_`, because the node shares the variables of
the program: ur-rtde's own names are common words, and a program's `q` or `velocity` would not survive the node.

Registers of integers, in the ranges that ur-rtde leaves to others (outputs 12 … 19, inputs 18 … 22; 24 more in the upper range): output
VERSION says which text the program has, OFFER holds the number while the arm is offered or taken, STATE says how far the node is, and
ECHO repeats each beat that the guard of the node has seen; input DUE is 1 when a replay is due, TAKE repeats the number, and BEAT changes
as long as the monitor lives. Their values outlive every connection, so a number is never used twice in a row, and a number alone is not
believed without a beat. A node that has waited for a beat in vain repeats the one that stands there, and no node waits for that one again:
a DUE that a dead monitor has left costs the program one wait, once.
"""

import json
import re
import socket
import subprocess
import sys

from monitor.acquire.ur.node_server import REQUEST
from monitor.errors import BadInput, RobotUnreachable
from monitor.reason import Sentence

HEADER_BEGIN, HEADER_END = "# HEADER_BEGIN", "# HEADER_END"  # what stands between them is put once at the top of the program
LOOP_BEGIN, LOOP_END = "# NODE_CONTROL_LOOP_BEGINS", "# NODE_CONTROL_LOOP_ENDS"
ASK = "cmd = rtde_cmd()"  # how ur-rtde's loop reads its next command
COMMANDS = frozenset(("11", "16", "35", "255"))  # servoJ, servoStop, setWatchdog and the end of the program
OURS = "jm_"  # how every name of the served text begins
VERSION, ECHO, OFFER, STATE = 16, 17, 18, 19  # output registers of the lower range
TAKE, BEAT, DUE = 20, 21, 22  # input registers of the lower range
UPPER = 24  # the upper range lies so much higher
IDLE, OFFERED, TAKEN, LOST, ASTRAY = range(5)  # values of STATE
NUMBER_MAX = 1_000_000


LIMITS = {  # of a hand-over, as the served text has them
    "wait_s": 0.08,  # how long the node waits for the monitor when a replay is due
    "silence_s": 0.12,  # without a beat for so long the arm stops and the program ends
    "standing_s": 1.0,  # the same before the first command of the control loop: nothing has moved yet
    "near_rad": 0.001,  # how near each joint must be to where the arm was taken
    "stop_rad_s2": 8.0,  # deceleration of the stop when contact is lost
}


def hand_over_script(control_script: str, *, version: int = 0) -> str:
    """The text that a node of a program gets: header, control loop and hand-over.

    control_script : ur-rtde's own text for the software of this controller, with the offset of its registers. version : what the program
    says of its text in the register VERSION; 0: nothing.
    Raises BadInput where ur-rtde's text is not as expected.
    """
    header, loop = _parts(_needed(control_script))
    offset = re.search(r"# int register offset\s*\n\s*(\d+)", header)
    if offset is None or int(offset[1]) not in (0, UPPER):
        raise BadInput("hand_over: ur-rtde's control script does not say which registers it uses; expected an offset of 0 or 24")
    if loop.count(ASK) != 1:
        raise BadInput(f"hand_over: ur-rtde's loop reads its command {loop.count(ASK)} times as {ASK!r}; expected once")
    own = _filled(_HEADER, int(offset[1])).replace("JM_VERSION", str(version))
    loop = _FORCE_MODE.sub("", loop.replace(ASK, "cmd = jm_command()"))
    node = _filled(_NODE, int(offset[1])).replace("LOOP\n", loop.strip("\n") + "\n")
    text = f"{HEADER_BEGIN}\n{header.strip(chr(10))}\n{own}{HEADER_END}\n\n{LOOP_BEGIN}\n{node}{LOOP_END}\n"
    return _renamed(text, _defined(text))


def control_program(host: str) -> str:
    """ur-rtde's whole program for this controller, with what a replay needs. Raises RobotUnreachable.

    ur-rtde puts the offsets of its registers behind two comments; they are there already, and would be there twice.
    """
    text = _needed(control_script(host)).replace(" register offset\n", " offset\n")
    return f"def rtde_control():\n{text}\nend\n"


def _needed(text: str) -> str:
    """ur-rtde's text with the commands that a replay sends: a name in another one that the controller does not know would refuse the whole.

    The last command stays too: the rest of the text is behind it.
    """
    first, *others = _BRANCH.split(text)
    branches = list(zip(others[::3], others[1::3], others[2::3], strict=True))  # line, number, what follows
    return first + "".join(line + body for line, number, body in branches if number in COMMANDS or number == branches[-1][1])


def _defined(text: str) -> set[str]:
    """The names that a text gives to variables, functions, their parameters and threads."""
    code = _WORD.sub(lambda found: found[0] if found["name"] else '""', text)  # neither comments nor texts
    names = {name for line in _DEFINED.finditer(code) for name in line.groups() if name}
    for parameters in re.findall(r"^\s*def\s+\w+\s*\(([^)]*)\)", code, re.MULTILINE):
        names |= set(re.findall(r"[A-Za-z_]\w*(?=\s*(?:,|=|$))", parameters))
    return names


def _renamed(text: str, names: set[str]) -> str:
    """The text with OURS before each of these names; the keywords of a call are names of what is called, and stay.

    Raises BadInput where a name would then be another one of the text.
    """
    taken = sorted(name for name in names if not name.startswith(OURS) and OURS + name in names)
    if taken:
        raise BadInput(f"hand_over: ur-rtde's control script names {', '.join(taken)}, which {OURS} would make a name of the node")
    depth, parts, end = 0, [], 0
    for found in _WORD.finditer(text):
        depth += _depth(text[end : found.start()])
        parts.append(text[end : found.start()])
        end = found.end()
        name = found["name"]
        keyword = depth > 0 and _ASSIGNED.match(text, end) is not None
        ours = name in names and not name.startswith(OURS) and not keyword and not (name == "p" and _is_pose(text, end))
        parts.append(OURS + found[0] if ours else found[0])
    return "".join([*parts, text[end:]])


def _depth(between: str) -> int:
    return between.count("(") - between.count(")")


def _is_pose(text: str, at: int) -> bool:
    """Whether a `p` that ends here is that of a pose, p[x, y, z, rx, ry, rz], and not a variable or one of its elements, p[0]."""
    if not text.startswith("[", at):
        return False
    depth = 0
    for sign in text[at:]:
        depth += (sign in "[(") - (sign in "])")
        if depth == 0 or (depth == 1 and sign == ","):
            return sign == ","
    return False


def _parts(text: str) -> tuple[str, str]:
    """Header and loop of ur-rtde's text. Raises BadInput where a mark is missing."""
    for mark in (HEADER_BEGIN, HEADER_END, LOOP_BEGIN, LOOP_END):
        if text.count(mark) != 1:
            raise BadInput(f"hand_over: ur-rtde's control script has {text.count(mark)} lines {mark!r}; expected one")
    header = text.split(HEADER_BEGIN)[1].split(HEADER_END, maxsplit=1)[0]
    loop = text.split(LOOP_BEGIN)[1].split(LOOP_END, maxsplit=1)[0]
    return header, loop


def _filled(text: str, offset: int) -> str:
    """A part of the text with its figures."""
    figures = {
        **{name: repr(limit) for name, limit in LIMITS.items()},
        **{name: str(place + offset) for name, place in _REGISTERS.items()},
        **{f"is_{name.lower()}": str(value) for name, value in _STATES.items()},
        "watchdog": f"input_int_register_{offset}",
        "number_max": str(NUMBER_MAX),
    }
    return re.sub(r"\{(\w+)\}", lambda name: figures[name[1]], text)


_WORD = re.compile(r'"[^"\n]*"|#[^\n]*|(?<![\w.])(?P<name>[A-Za-z_]\w*)')  # a text, a comment, or a name
_ASSIGNED = re.compile(r"\s*=(?!=)")
_DEFINED = re.compile(r"(?:^|\n|\d\s)[ \t]*(?:(?:def|thread)\s+(\w+)|(?:global\s+|local\s+)?([A-Za-z_]\w*)(?:\[[^\]\n]*\])?\s*=(?!=))")
_FORCE_MODE = re.compile(r"^[ \t]*force_mode_set_(?:gain_scaling|damping)\([^\n]*\n", re.MULTILINE)  # they would replace the program's own
_BRANCH = re.compile(r"^([ \t]*elif cmd == (\d+):\n)", re.MULTILINE)
_REGISTERS = {"VERSION": VERSION, "ECHO": ECHO, "OFFER": OFFER, "STATE": STATE, "TAKE": TAKE, "BEAT": BEAT, "DUE": DUE}
_STATES = {"IDLE": IDLE, "OFFERED": OFFERED, "TAKEN": TAKEN, "LOST": LOST, "ASTRAY": ASTRAY}
_HEADER = """
    # joint-monitor: hand-over of the arm
    global jm_number = 0
    global jm_leaving = 0
    global jm_commanded = False
    global jm_given_up = False
    global jm_guard_thrd = 0
    global jm_taken_q = [0, 0, 0, 0, 0, 0]
    write_output_integer_register({VERSION}, JM_VERSION)

    # The next command of the control loop. Once the monitor has withdrawn the number, 255 ends the loop; the 0 before it is needed,
    # because the loop begins no command until it has seen the end of the one before. Once the arm is given up there is none.
    def jm_command():
        if jm_given_up:
            return 0
        end
        if read_input_integer_register({TAKE}) == jm_number:
            jm_asked = rtde_cmd()
            if jm_asked != 0:
                jm_commanded = True
            end
            return jm_asked
        end
        if jm_leaving == 0:
            jm_leaving = 1
            return 0
        end
        return 255
    end

    def jm_end_threads():
        enter_critical
        kill servo_thrd
        kill servoc_thrd
        kill speed_thrd
        kill move_thrd
        kill stop_thrd
        kill force_thrd
        kill jog_thrd
        kill contact_thrd
        servo_thrd = 0
        servoc_thrd = 0
        speed_thrd = 0
        move_thrd = 0
        stop_thrd = 0
        force_thrd = 0
        jog_thrd = 0
        contact_thrd = 0
        is_servoing = 0
        is_speeding = 0
        is_in_forcemode = 0
        internal_cmd = 0
        exit_critical
    end

    # Ends the program where the arm is: no node may follow from a pose that the program did not choose.
    def jm_give_up(state, text):
        jm_given_up = True
        write_output_integer_register({STATE}, state)
        sync()  # the loop ends what it has begun: a thread that it started now would hold the arm while it stops
        jm_end_threads()
        stopj({stop_rad_s2})
        textmsg(text)
        halt
    end

    thread jm_guard():
        jm_last_beat = read_input_integer_register({BEAT})
        jm_silent_s = 0.0
        while True:
            jm_beat = read_input_integer_register({BEAT})
            if jm_beat != jm_last_beat:
                jm_last_beat = jm_beat
                jm_silent_s = 0.0
                write_output_integer_register({ECHO}, jm_beat)
            end
            jm_silent_s = jm_silent_s + get_steptime()
            if jm_silent_s > {standing_s} or (jm_commanded and jm_silent_s > {silence_s}):
                jm_give_up({is_lost}, "joint-monitor: contact lost, the program ends here")
            end
            sync()
        end
    end
"""
_NODE = """
        jm_number = read_output_integer_register({OFFER}) + 1
        if jm_number > {number_max} or jm_number < 1:
            jm_number = 1
        end
        write_output_integer_register({OFFER}, jm_number)
        if read_input_integer_register({DUE}) == 1 and read_input_integer_register({BEAT}) != read_output_integer_register({ECHO}):
            write_output_integer_register({STATE}, {is_offered})
            jm_waited_s = 0.0
            jm_first_beat = read_input_integer_register({BEAT})
            jm_alive = False
            while jm_waited_s < {wait_s} and (read_input_integer_register({TAKE}) != jm_number or not jm_alive):
                sync()
                jm_waited_s = jm_waited_s + get_steptime()
                jm_alive = jm_alive or read_input_integer_register({BEAT}) != jm_first_beat
            end
            if not jm_alive:
                write_output_integer_register({ECHO}, jm_first_beat)  # nobody is there: no node waits for this beat again
            end
            # a command that stands in its register already is none for this arm
            if read_input_integer_register({TAKE}) == jm_number and jm_alive and rtde_cmd() == 0:
                jm_given_up = False
                jm_taken_q = get_target_joint_positions()
                jm_leaving = 0
                jm_commanded = False
                jm_guard_thrd = run jm_guard()
                write_output_integer_register({STATE}, {is_taken})
LOOP
                kill jm_guard_thrd
                jm_guard_thrd = 0
                jm_end_threads()
                write_output_integer_register(0 + reg_offset_int, 0)
                rtde_set_watchdog("{watchdog}", 1.0, "ignore")
                stopj({stop_rad_s2})  # an arm that passes by stands elsewhere
                jm_joint = 0
                jm_here_q = get_target_joint_positions()
                while jm_joint < 6:
                    if norm(jm_here_q[jm_joint] - jm_taken_q[jm_joint]) > {near_rad}:
                        jm_give_up({is_astray}, "joint-monitor: the arm is not where it was taken, the program ends here")
                    end
                    jm_joint = jm_joint + 1
                end
            end
        end
        write_output_integer_register({STATE}, {is_idle})
"""


REQUEST_LINE = REQUEST.decode() + "\n"  # ur-rtde compares the whole line
CHILD_S = 30.0  # connecting takes some tenths of a second; a controller that does not answer takes several
_CHILD = """
import json, socket, sys
from rtde_control import RTDEControlInterface as Control
host, port = sys.argv[1], int(sys.argv[2])
control = Control(host, 125.0, Control.FLAG_USE_EXT_UR_CAP | Control.FLAG_NO_WAIT, port)
with socket.create_connection(("127.0.0.1", port), timeout=2.0) as wire:
    wire.sendall(sys.argv[3].encode())
    wire.settimeout(0.5)
    text = b""
    try:
        while more := wire.recv(65536):
            text += more
    except TimeoutError:
        pass
print("\\n" + json.dumps(text.decode()), flush=True)
import os
os._exit(0)
"""


SCRIPT_NOT_SERVED_IN_TIME = Sentence(
    "script_not_served_in_time", "{host}: no answer within {limit_s:g} s while asking for ur-rtde's control script"
)
SCRIPT_NOT_SERVED = Sentence("script_not_served", "{host}: ur-rtde could not serve its control script: {why}")


def control_script(host: str) -> str:
    """The text for the controller at this address. Raises RobotUnreachable where it does not answer."""
    with socket.socket() as wire:  # a free port of this host
        wire.bind(("127.0.0.1", 0))
        port = wire.getsockname()[1]
    command = [sys.executable, "-c", _CHILD, host, str(port), REQUEST_LINE]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=CHILD_S, check=False)
    except subprocess.TimeoutExpired:
        raise RobotUnreachable(SCRIPT_NOT_SERVED_IN_TIME(host=host, limit_s=CHILD_S)) from None
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        raise RobotUnreachable(SCRIPT_NOT_SERVED(host=host, why=last))
    text: str = json.loads(done.stdout.strip().splitlines()[-1])
    return text
