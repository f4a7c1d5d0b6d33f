"""Functions of URScript that have a value and take no time, and the arithmetic of its values."""

import ast
import math
import operator
from collections.abc import Callable, Generator, Iterator
from typing import Any

import numpy as np

from monitor.simulate.arm.kinematics import composed, pose_of, se3
from monitor.simulate.machine.machine import Machine
from monitor.simulate.program import queries
from monitor.simulate.program.language import (
    Assign,
    Block,
    Evaluate,
    Expression,
    Function,
    If,
    Jump,
    Return,
    ScriptError,
    Source,
)
from monitor.simulate.program.queries import touched
from monitor.simulate.program.steps import STEPS, Step, step_of, takes_time, text_of

TEXT_MAX = 1023  # characters of a text, as the manufacturer's guide limits them

Value = Any  # a number, a truth value, a text, a list of values, or a pose


class Pose(list[Value]):
    """A pose p[x, y, z, rx, ry, rz]."""

    is_pose = True


def evaluated(operation: Callable[[Any, Any], Any], a: Value, b: Value) -> Value:
    """The result of an operation. Lists are added element by element, and multiplied by numbers.

    Raises TypeError for other kinds of values.
    """
    if isinstance(a, str) or isinstance(b, str):
        raise TypeError("a text is no number")
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            raise TypeError(f"lists of {len(a)} and {len(b)} elements")
        return [evaluated(operation, x, y) for x, y in zip(a, b, strict=True)]
    if isinstance(a, list):
        return [evaluated(operation, x, b) for x in a]
    if isinstance(b, list):
        return [evaluated(operation, a, y) for y in b]
    return operation(a, b)


def _joined(first: str, second: str) -> str:
    if len(first) + len(second) > TEXT_MAX:
        raise ValueError(f"str_cat: a text of more than {TEXT_MAX} characters")
    return first + second


def _norm(_: Machine | None, value: Value) -> float:
    return math.hypot(*map(float, value)) if isinstance(value, list) else abs(float(value))


def _solution(machine: Machine, pose: Value, near: Value = None, *_: Value) -> np.ndarray | None:
    """(6,) joint positions for a pose; None where there are none, or a figure is not finite."""
    if not np.isfinite([*pose, *(near or ())]).all():
        return None
    return machine.moves.inverse(_figures(pose), None if near is None else _figures(near))


def _inverse(machine: Machine, pose: Value, near: Value = None, *_: Value) -> Value:
    """get_inverse_kin; the largest errors of position and orientation behind `near` are not modelled."""
    found = _solution(machine, pose, near)
    if found is None:
        raise ValueError(f"get_inverse_kin: no joint positions for {text_of(pose)}")
    return found.tolist()


def _forward(machine: Machine, q: Value = None, tool: Value = None) -> Value:
    at = machine.measurements.latest.q if q is None else _figures(q)
    return Pose(machine.kinematics.pose(at, None if tool is None else _figures(tool)).tolist())


def _figures(value: Value) -> np.ndarray:
    figures = np.array(value, dtype=float)
    if figures.shape != (6,) or not np.isfinite(figures).all():
        raise ValueError(f"{text_of(value)} is not a list of 6 finite figures")
    return figures


def _register(machine: Machine, kind: str, number: Value) -> Value:
    if not 0 <= int(number) < 48:
        raise ValueError(f"register {number}; expected 0 … 47")
    registers = machine.registers
    files: dict[str, list[Value]] = {
        "read_input_integer_register": registers.inputs.ints,
        "read_input_float_register": registers.inputs.doubles,
        "read_output_integer_register": registers.output_ints,
        "read_output_float_register": registers.output_doubles,
    }
    return files[kind][int(number)]


def _bit(machine: Machine, first: int, count: int, number: Value) -> bool:
    if not 0 <= int(number) < count:
        raise ValueError(f"input {number}; expected 0 … {count - 1}")
    return bool(machine.registers.digital_inputs >> (first + int(number)) & 1)


PURE: dict[str, Callable[..., Value]] = {  # functions of URScript, called with the machine first; these do not ask it
    "norm": _norm,
    "length": lambda _, value: len(value),
    "get_list_length": lambda _, value: len(value),
    "size": lambda _, value: len(value),
    "floor": lambda _, value: math.floor(value),
    "ceil": lambda _, value: math.ceil(value),
    "sqrt": lambda _, value: math.sqrt(value),
    "pow": lambda _, base, exponent: math.pow(base, exponent),
    "sin": lambda _, value: math.sin(value),
    "cos": lambda _, value: math.cos(value),
    "tan": lambda _, value: math.tan(value),
    "asin": lambda _, value: math.asin(value),
    "acos": lambda _, value: math.acos(value),
    "atan": lambda _, value: math.atan(value),
    "atan2": lambda _, y, x: math.atan2(y, x),
    "d2r": lambda _, value: math.radians(value),
    "r2d": lambda _, value: math.degrees(value),
    "to_str": lambda _, value: text_of(value),
    "to_num": lambda _, value: float(value),
    "str_cat": lambda _, first, second: _joined(text_of(first), text_of(second)),
    "str_len": lambda _, value: len(value),
    "pose_trans": lambda _, first, second: Pose(composed(_figures(first), _figures(second)).tolist()),
    "pose_inv": lambda _, pose: Pose(pose_of(se3(_figures(pose)).inverse()).tolist()),
    "pose_add": lambda _, first, second: Pose(_pose_add(_figures(first), _figures(second))),
    "pose_sub": lambda _, first, second: Pose(_pose_add(_figures(first), -_figures(second))),
    # modes of force control and freedrive that never begin here: their settings and ends change nothing
    **dict.fromkeys(("force_mode_set_damping", "force_mode_set_gain_scaling"), lambda _, _value: None),
    **dict.fromkeys(("end_force_mode", "end_teach_mode", "end_freedrive_mode", "zero_ftsensor"), lambda _: None),
    "get_freedrive_status": lambda _: 0,
}


def _pose_add(first: np.ndarray, second: np.ndarray) -> list[float]:
    turned = pose_of(se3(np.concatenate((np.zeros(3), first[3:]))) * se3(np.concatenate((np.zeros(3), second[3:]))))
    return [*(first[:3] + second[:3]).tolist(), *turned[3:].tolist()]


def _within(machine: Machine, target: Value) -> bool:
    """is_within_safety_limits of a pose or of joint positions."""
    if getattr(target, "is_pose", False):
        return _solution(machine, target) is not None
    return bool(np.isfinite(target).all()) and not machine.limits.outside(_figures(target))


ASKING: dict[str, Callable[..., Value]] = {
    "get_actual_joint_positions": lambda machine: machine.measurements.latest.q.tolist(),
    "get_joint_positions": lambda machine: machine.measurements.latest.q.tolist(),
    "get_actual_joint_speeds": lambda machine: machine.measurements.latest.qd.tolist(),
    "get_target_joint_positions": lambda machine: machine.reference.q.tolist(),
    "get_target_joint_speeds": lambda machine: machine.reference.qd.tolist(),
    "get_actual_tcp_pose": _forward,
    "get_target_tcp_pose": lambda machine: _forward(machine, machine.reference.q.tolist()),
    "get_forward_kin": _forward,
    "get_inverse_kin": _inverse,
    "get_tcp_offset": lambda machine: Pose(machine.kinematics.tool.tolist()),
    "get_target_tcp_speed": lambda machine: machine.kinematics.speed(machine.reference.q, machine.reference.qd).tolist(),
    "get_actual_tool_flange_pose": lambda machine: Pose(queries.flange_pose(machine).tolist()),
    "get_target_waypoint": lambda machine: Pose(queries.waypoint(machine).tolist()),
    "get_inverse_kin_has_solution": lambda *asked: _solution(*asked) is not None,
    "is_within_safety_limits": _within,
    "get_joint_torques": lambda machine: queries.external_torque(machine).tolist(),
    "get_target_joint_accelerations": lambda machine: machine.reference.qdd.tolist(),
    "get_actual_joint_positions_history": lambda machine, steps: queries.positions_before(machine, int(steps)).tolist(),
    "tool_contact": lambda machine, *_, **_named: int(touched(machine)),
    "get_target_payload": lambda machine: machine.installation.payload[0],
    "get_target_payload_cog": lambda machine: list(machine.installation.payload[1:4]),
    "get_target_payload_inertia": lambda machine: list(machine.installation.inertia_kg_m2),
    "get_steptime": lambda machine: machine.clock.tick_s,
    "is_steady": lambda machine: machine.standing,
    **{
        f"read_{way}_{kind}_register": lambda machine, number, name=f"read_{way}_{kind}_register": _register(machine, name, number)
        for way in ("input", "output")
        for kind in ("integer", "float")
    },
    **{
        f"get_{kind}_digital_in": lambda machine, number, first=first, count=count: _bit(machine, first, count, number)
        for kind, first, count in (("standard", 0, 8), ("configurable", 8, 8), ("tool", 16, 2))
    },
}
FUNCTIONS = PURE | ASKING


# --- Runs a parsed program: it yields the steps that take time or have an effect, one after another -----

STATEMENTS_MAX = 4000  # statements that a program may execute without a step that takes time
CALLS_MAX = 40  # functions within functions
NESTING_MAX = 3  # lists within lists

Scope = dict[str, Value]
Steps = Generator[Step, int | None, None]  # who plays the steps answers `Run` with the number of the thread
Evaluation = Generator[Step, int | None, Value]
OPERATORS: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.BitXor: lambda a, b: bool(a) != bool(b),
}
COMPARISONS: dict[type[ast.AST], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}


class NeedsMachine(Exception):
    """An expression asks for the state of a controller, and there is none."""


class _Returned(Exception):
    """A function returned."""

    def __init__(self, value: Value) -> None:
        self.value = value


class Halted(Exception):
    """A program said `halt`: all its threads end."""


class Execution:
    """One execution of a program: its main thread and those that it starts share the global variables.

    Without a machine, a program that asks for the state of the controller raises NeedsMachine.
    """

    def __init__(self, program: Source, machine: Machine | None) -> None:
        self._program, self._machine = program, machine
        self._globals: Scope = {}

    def main(self) -> Steps:
        """The steps of the program as they come. Raises ScriptError where a real controller raises a runtime exception, and Halted."""
        return self._steps(self._program.body, self._globals)

    def thread(self, name: str) -> Steps:
        """The steps of a thread. Raises as `main`."""
        return self._steps(self._program.threads[name], {})

    def _steps(self, block: Block, scope: Scope) -> Steps:
        try:
            yield from _Run(self._program, self._machine, self._globals).block(block, scope)
        except _Returned:
            return


def run(program: Source, machine: Machine | None) -> Iterator[Step]:
    """The steps of a program without threads. Raises as `Execution.main`, except that `halt` only ends it."""
    try:
        yield from Execution(program, machine).main()
    except Halted:
        return


def _nesting(value: Value, left: int = NESTING_MAX) -> None:
    """Raises ValueError for lists too deep within each other: they could grow without limit within one control period."""
    if isinstance(value, list):
        if left == 0:
            raise ValueError(f"more than {NESTING_MAX} lists within each other")
        for element in value:
            _nesting(element, left - 1)


def _copied(value: Value) -> Value:
    """A list as a new one: assignments copy."""
    return type(value)(map(_copied, value)) if isinstance(value, list) else value


class _Run:
    """One thread of an execution."""

    def __init__(self, program: Source, machine: Machine | None, common: Scope) -> None:
        self._program, self._machine = program, machine
        self.globals = common
        self._statements = self._depth = 0

    def block(self, block: Block, scope: Scope) -> Generator[Step, int | None, str]:
        """Execute statements. Returns "break" or "continue" if the loop around them shall do that, else an empty text."""
        for statement in block:
            self._statements += 1
            match statement:
                case Evaluate(value):
                    yield from self._value(value, value.node, scope)
                case Assign():
                    yield from self._assign(statement, scope)
                case If(branches, otherwise):
                    chosen = otherwise
                    for condition, body in branches:
                        if (yield from self._value(condition, condition.node, scope)):
                            chosen = body
                            break
                    jump = yield from self.block(chosen, scope)
                    if jump:
                        return jump
                case Return(value):
                    raise _Returned((yield from self._value(value, value.node, scope)) if value else None)
                case Jump(kind):
                    if kind == "halt":
                        raise Halted
                    return kind
                case _:
                    while (yield from self._value(statement.condition, statement.condition.node, scope)):
                        self._count(statement.condition)
                        if (yield from self.block(statement.body, scope)) == "break":
                            break
        return ""

    def _count(self, where: Expression) -> None:
        """Raises ScriptError in a loop in which no time passes."""
        self._statements += 1
        if self._statements > STATEMENTS_MAX:
            raise where.error(f"runtime_error: a loop without a step that takes time, after {STATEMENTS_MAX} statements")

    def _assign(self, statement: Assign, scope: Scope) -> Steps:
        value = _copied((yield from self._value(statement.value, statement.value.node, scope)))
        there = self._scope_of(statement, scope)
        if statement.index is None:
            there[statement.name] = value
            return
        index = yield from self._value(statement.index, statement.index.node, scope)
        try:
            there[statement.name][int(index)] = value
            _nesting(there[statement.name])
        except (KeyError, TypeError, IndexError, ValueError):
            raise statement.value.error(f"runtime_error: {statement.name}[{index}] does not exist") from None

    def _scope_of(self, statement: Assign, scope: Scope) -> Scope:
        """Where a variable lies: without `local` and `global` it is the function's, else a global one, else a new one of the function."""
        if statement.scope:
            return scope if statement.scope == "local" else self.globals
        return self.globals if statement.name not in scope and statement.name in self.globals else scope

    # --- expressions --------------------------------------------------------------------------------------------
    def _value(self, where: Expression, node: ast.expr, scope: Scope) -> Evaluation:
        """The value of a node of an expression."""
        try:
            return (yield from self._node(where, node, scope))
        except (TypeError, ValueError, IndexError, ZeroDivisionError, OverflowError, AttributeError) as wrong:
            raise where.error(f"runtime_error: {wrong}", node) from None
        except RecursionError:
            raise where.error("runtime_error: the expression is too deep", node) from None

    def _node(self, where: Expression, node: ast.expr, scope: Scope) -> Evaluation:
        match node:
            case ast.Constant(value):
                return value
            case ast.Name(name):
                for names in (scope, self.globals):
                    if name in names:
                        return names[name]
                raise where.error(f"compile_error_name_not_found:{name}:", node)
            case ast.List(elements):
                made = yield from self._nodes(where, elements, scope)
                _nesting(made)
                return made
            case ast.Subscript(ast.Name("p"), ast.Tuple(elements)):
                return Pose((yield from self._nodes(where, elements, scope)))
            case ast.Subscript(value, index):
                container = yield from self._node(where, value, scope)
                return container[int((yield from self._node(where, index, scope)))]
            case ast.UnaryOp(sign, operand):
                value = yield from self._node(where, operand, scope)
                if isinstance(sign, ast.Not):
                    return not value
                return evaluated(operator.mul, -1 if isinstance(sign, ast.USub) else 1, value)
            case ast.BinOp(left, sign, right) if type(sign) in OPERATORS:
                first = yield from self._node(where, left, scope)
                return evaluated(OPERATORS[type(sign)], first, (yield from self._node(where, right, scope)))
            case ast.BoolOp(sign, parts):
                wanted = isinstance(sign, ast.Or)
                for part in parts:
                    if bool((yield from self._node(where, part, scope))) == wanted:
                        return wanted
                return not wanted
            case ast.Compare(left, [sign], [right]) if type(sign) in COMPARISONS:
                first = yield from self._node(where, left, scope)
                return COMPARISONS[type(sign)](first, (yield from self._node(where, right, scope)))
            case ast.Call():
                return (yield from self._call(where, node, scope))
        raise where.error("syntax_error: this expression is not understood", node)

    def _nodes(self, where: Expression, nodes: list[ast.expr], scope: Scope) -> Generator[Step, int | None, list[Value]]:
        values = []
        for node in nodes:
            values.append((yield from self._node(where, node, scope)))
        return values

    def _call(self, where: Expression, node: ast.Call, scope: Scope) -> Evaluation:
        assert isinstance(node.func, ast.Name)  # the parser has checked it
        name = node.func.id
        arguments = yield from self._nodes(where, node.args, scope)
        values = yield from self._nodes(where, [keyword.value for keyword in node.keywords], scope)
        named = dict(zip((str(keyword.arg) for keyword in node.keywords), values, strict=True))
        if name in self._program.functions:
            return (yield from self._call_own(where, node, self._program.functions[name], arguments, named))
        if name in STEPS:
            try:
                step = step_of(name, arguments, named)
            except ScriptError as wrong:
                raise where.error(wrong.text, node) from None
            if takes_time(step):
                self._statements = 0
            return (yield step)
        if name not in FUNCTIONS:
            raise where.error(f"not simulated: {name}", node)
        if name in ASKING and self._machine is None:
            raise NeedsMachine(name)
        return FUNCTIONS[name](self._machine, *arguments, **named)

    def _call_own(self, where: Expression, node: ast.Call, function: Function, arguments: list[Value], named: Scope) -> Evaluation:
        """Call a function of the program."""
        self._count(where)
        scope: Scope = dict(zip((name for name, _ in function.parameters), arguments, strict=False)) | named
        for name, default in function.parameters:
            if name not in scope:
                if default is None:
                    raise where.error(f"runtime_error: the argument {name} is missing", node)
                scope[name] = yield from self._value(default, default.node, self.globals)
        if self._depth >= CALLS_MAX or len(arguments) > len(function.parameters):
            raise where.error("runtime_error: too many calls within each other, or too many arguments", node)
        self._depth += 1
        try:
            yield from self.block(function.body, scope)
        except _Returned as returned:
            return returned.value
        finally:
            self._depth -= 1
        return None
