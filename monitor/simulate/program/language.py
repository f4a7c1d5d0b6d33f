"""The part of URScript that this controller understands, parsed into statements.

A program is `def name():` or `sec name():`, statements, and `end`. Statements are assignments, calls, `if`, `while`, `def` and `thread`
within the program, `return`, `break`, `continue`, `pass`, `halt`, `kill` and `join`. An expression of URScript is one of Python too, so
Python's own parser reads it; only the few kinds of node in NODES are accepted. `run name()` becomes the call `run("name")`.
"""

import ast
import keyword
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

DEPTH_MAX = 40  # of statements within statements
TEXT_MAX = 80  # characters of a line that a message repeats
NODES = (
    ast.Constant,
    ast.Name,
    ast.List,
    ast.Tuple,
    ast.Subscript,
    ast.Call,
    ast.keyword,
    ast.UnaryOp,
    ast.BinOp,
    ast.BoolOp,
    ast.Compare,
    ast.expr_context,
    ast.operator,
    ast.unaryop,
    ast.boolop,
    ast.cmpop,
)
_HEAD = re.compile(r"^(def|sec|thread)\s+(\w+)\s*\((.*)\)\s*:?$")
_ASSIGN = re.compile(r"^(?:(global|local)\s+)?([A-Za-z_]\w*)\s*(\[[^=]*\])?\s*=(?!=)\s*(.*)$", re.DOTALL)
_STRING = re.compile(r'"[^"]*"')
_RUN = re.compile(r"^run\s+([A-Za-z_]\w*)\s*\(\s*\)$")  # starts a thread; its value names the thread for `kill` and `join`
_WORDS = {"xor": "^"} | {  # what Python reads otherwise: its own keywords are ordinary names of URScript
    word: f"{word}_" for word in keyword.kwlist if word not in {"and", "or", "not", "True", "False", "global", "if", "else", "while"}
}
_FOREIGN_WORD = re.compile(rf"\b({'|'.join(_WORDS)})\b")
_DECLARATION = re.compile(r"(?<=[\w\])])\s+(?=(?:global|local)\s+[A-Za-z_]\w*\s*=)")  # as ur-rtde writes the offsets of its registers
_BLOCK = re.compile(r"^(if|elif|while)\b\s*(.*?):?$", re.DOTALL)


class ScriptError(Exception):
    """A script cannot be run, or not any further. Line and column count from 1."""

    def __init__(self, text: str, line: int = 1, column: int = 1) -> None:
        super().__init__(text)
        self.text, self.line, self.column = text, line, column


@dataclass(frozen=True, slots=True)
class Expression:
    """An expression, with its place in the script."""

    node: ast.expr
    line: int
    column: int

    def error(self, text: str, node: ast.AST | None = None) -> ScriptError:
        """An error at a node of this expression, or at its beginning."""
        return ScriptError(text, self.line, self.column + (getattr(node, "col_offset", 1) - 1 if node is not None else 0))


@dataclass(frozen=True, slots=True)
class Evaluate:
    """An expression as a statement: a call."""

    value: Expression


@dataclass(frozen=True, slots=True)
class Assign:
    """`name = value` or `name[index] = value`; `scope` is "global", "local" or empty."""

    name: str
    index: Expression | None
    value: Expression
    scope: str


@dataclass(frozen=True, slots=True)
class If:
    """Branches with their conditions, and what happens if none of them holds."""

    branches: tuple[tuple[Expression, "Block"], ...]
    otherwise: "Block"


@dataclass(frozen=True, slots=True)
class While:
    """A loop."""

    condition: Expression
    body: "Block"
    line: int


@dataclass(frozen=True, slots=True)
class Return:
    """The end of a function, with its value."""

    value: Expression | None


@dataclass(frozen=True, slots=True)
class Jump:
    """`break`, `continue` or `halt`."""

    kind: str


Statement = Evaluate | Assign | If | While | Return | Jump
Block = tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Function:
    """A function of the program: its parameters with their defaults, and its body."""

    parameters: tuple[tuple[str, Expression | None], ...]
    body: Block


@dataclass(frozen=True, slots=True)
class Source:
    """A program that was parsed."""

    name: str
    body: Block
    functions: dict[str, Function] = field(default_factory=dict)
    threads: dict[str, Block] = field(default_factory=dict)
    secondary: bool = False  # a secondary program takes no time and does not end the one that runs

    @property
    def straight(self) -> bool:
        """Whether the program is a list of calls, without variables, branches and loops."""
        return not self.functions and not self.threads and all(isinstance(statement, Evaluate) for statement in self.body)


def parsed(text: str, name: str, known: Collection[str]) -> Source:
    """Parse a whole program or a single line; a line has the given name. `known` are the names of all functions that exist.

    Raises ScriptError for what is not understood.
    """
    lines = _Lines(text)
    head = _HEAD.match(lines.text) if lines.more else None
    if head is None:
        body = _block(lines, (), 0)
    else:
        if head[1] == "thread":
            raise ScriptError("syntax_error: a thread stands within a program")
        name = head[2]
        lines.next()
        body = _block(lines, ("end",), 0)
        lines.next()
    if lines.more:
        raise lines.error("syntax_error: this is behind the end of the program")
    surely = {id(statement.value) for statement in body if isinstance(statement, Evaluate | Assign)}
    names = {*known, *lines.functions}
    for expression in lines.expressions:
        _check(expression, names, lines.threads, refuse=id(expression) in surely)
    return Source(name, body, lines.functions, lines.threads, secondary=head is not None and head[1] == "sec")


class _Lines:
    """The lines of a script without comments, and what was found in them; a line with an open bracket continues on the next one."""

    def __init__(self, text: str) -> None:
        self.expressions: list[Expression] = []
        self.functions: dict[str, Function] = {}
        self.threads: dict[str, Block] = {}
        self._all: list[tuple[int, int, str]] = []  # number, column of the first character, text
        open_brackets, number, column, whole = 0, 0, 1, ""
        for i, raw in enumerate(_split(text), start=1):
            for part in raw:
                line = _without_comment(part)
                if not whole:
                    number, column = i, len(line) - len(line.lstrip()) + 1
                whole += line + (" " if open_brackets else "")
                bare = _STRING.sub("", line)
                open_brackets = max(0, open_brackets + sum(map(bare.count, "([")) - sum(map(bare.count, ")]")))
                if not open_brackets and not whole.endswith("="):
                    if whole.strip():
                        self._all.append((number, column, whole.strip()))
                    whole = ""
        if whole:
            raise ScriptError("syntax_error: a bracket is never closed, or a value is missing", number)
        self._at = 0

    @property
    def more(self) -> bool:
        """Whether lines are left."""
        return self._at < len(self._all)

    @property
    def text(self) -> str:
        """The present line."""
        return self._all[self._at][2]

    @property
    def line(self) -> int:
        """The number of the present line; the last one behind the end."""
        return self._all[min(self._at, len(self._all) - 1)][0] if self._all else 1

    def next(self) -> None:
        """Go on to the next line."""
        self._at += 1

    def error(self, text: str) -> ScriptError:
        """An error in the present line."""
        return ScriptError(text, self.line)

    def expression(self, text: str) -> Expression:
        """A part of the present line as an expression."""
        text = text.strip()
        number, column, whole = self._all[self._at]
        started = _RUN.match(text)
        try:
            node = ast.parse(f'run("{started[1]}")' if started else f"({_as_python(text)})", mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise self.error(f"syntax_error: {text[:TEXT_MAX]!r} is no expression") from None
        made = Expression(node, number, column + max(whole.rfind(text), 0))  # mostly the last part of the line
        self.expressions.append(made)
        return made


def _split(text: str) -> Iterator[list[str]]:
    """The lines of a script, each as its statements: a declaration may stand behind the value of another one."""
    for line in text.split("\n"):
        yield [line] if line.lstrip().startswith("#") else _DECLARATION.split(line)


def _as_python(text: str) -> str:
    """An expression with Python's own keywords as names; texts within it stay."""
    outside, texts = _STRING.split(text), _STRING.findall(text)
    outside = [_FOREIGN_WORD.sub(lambda word: _WORDS[word[0]], part) for part in outside]
    return "".join(part + text for part, text in zip(outside, [*texts, ""], strict=True))


def _without_comment(line: str) -> str:
    bare = _STRING.sub(lambda found: "x" * len(found[0]), line)
    return line[: bare.find("#")].rstrip() if "#" in bare else line.rstrip()


def _block(lines: _Lines, ends: tuple[str, ...], depth: int) -> Block:
    """Statements until a line that begins with one of the words in `ends`, which stays; without ends, until no line is left."""
    if depth > DEPTH_MAX:
        raise lines.error(f"syntax_error: more than {DEPTH_MAX} blocks within each other")
    statements: list[Statement] = []
    while lines.more:
        word = re.split(r"\W", lines.text, maxsplit=1)[0]
        if word in ends:
            return tuple(statements)
        statement = _statement(lines, word, depth)
        if statement is not None:
            statements.append(statement)
    if ends:
        raise lines.error("syntax_error: the program has no end")
    return tuple(statements)


def _statement(lines: _Lines, word: str, depth: int) -> Statement | None:
    text, line = lines.text, lines.line
    block = _BLOCK.match(text)
    if word in {"def", "sec", "thread"}:
        _function(lines, depth)
        return None
    if block and word == "while":
        condition = lines.expression(block[2])
        lines.next()
        body = _block(lines, ("end",), depth + 1)
        lines.next()
        return While(condition, body, line)
    if block and word == "if":
        return _if(lines, depth)
    made: Statement | None
    assignment = _ASSIGN.match(text)
    if word in {"break", "continue", "halt"}:
        made = Jump(word)
    elif word == "pass":
        made = None
    elif text in {"enter_critical", "exit_critical"}:
        made = Evaluate(lines.expression(f"{text}()"))
    elif word in {"kill", "join"}:
        made = Evaluate(lines.expression(f"{word}({text[4:].strip()})"))
    elif word == "return":
        made = Return(lines.expression(text[6:]) if text[6:].strip() else None)
    elif assignment:
        index = lines.expression(assignment[3][1:-1]) if assignment[3] else None
        made = Assign(_as_python(assignment[2]), index, lines.expression(assignment[4]), assignment[1] or "")
    else:
        made = Evaluate(lines.expression(text))
        if not isinstance(made.value.node, ast.Call):
            raise lines.error(f"syntax_error: {text[:TEXT_MAX]!r} does nothing")
    lines.next()
    return made


def _if(lines: _Lines, depth: int) -> If:
    branches: list[tuple[Expression, Block]] = []
    otherwise: Block = ()
    while True:
        head = _BLOCK.match(lines.text)
        condition = lines.expression(head[2]) if head else None
        lines.next()
        body = _block(lines, ("elif", "else", "end"), depth + 1)
        if condition is None:
            otherwise = body
        else:
            branches.append((condition, body))
        if lines.text.startswith("end"):
            lines.next()
            return If(tuple(branches), otherwise)
        if condition is None:
            raise lines.error("syntax_error: a branch behind `else`")


def _function(lines: _Lines, depth: int) -> None:
    head = _HEAD.match(lines.text)
    if head is None or head[1] == "sec":
        raise lines.error(f"{lines.text[:TEXT_MAX]}: a secondary program within a program is not understood")
    parameters: list[tuple[str, Expression | None]] = []
    for part in filter(None, map(str.strip, head[3].split(","))):
        name, equals, default = part.partition("=")
        parameters.append((_as_python(name.strip()), lines.expression(default) if equals else None))
    if head[1] == "thread" and parameters:
        raise lines.error(f"syntax_error: the thread {head[2]} has parameters; a thread has none")
    lines.next()
    body = _block(lines, ("end",), depth + 1)
    if head[1] == "thread":
        lines.threads[head[2]] = body
    else:
        lines.functions[head[2]] = Function(tuple(parameters), body)
    lines.next()


def _check(expression: Expression, known: set[str], threads: Collection[str], *, refuse: bool) -> None:
    """Every node is one that is understood, and every function and thread that is called exists. Raises ScriptError.

    A function that a real arm has and this one has not is refused here if it is called whatever happens, and else when it is called.
    """
    for node in _nodes(expression.node):
        if not isinstance(node, NODES):
            raise expression.error(f"syntax_error: {type(node).__name__} is not understood", node)
        if not isinstance(node, ast.Call):
            continue
        if not isinstance(node.func, ast.Name) or any(word.arg is None for word in node.keywords):
            raise expression.error("syntax_error: expected the name of a function", node)
        name = node.func.id
        if name not in known and name not in NOT_SIMULATED:
            raise expression.error(f"compile_error_name_not_found:{name}:", node)
        if name not in known and refuse:
            raise expression.error(f"not simulated: {name}", node)
        if name == "run" and not (node.args and isinstance(node.args[0], ast.Constant) and node.args[0].value in threads):
            raise expression.error("compile_error_name_not_found: `run` expects the name of a thread of the program", node)


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    yield node
    for child in ast.iter_child_nodes(node):
        yield from _nodes(child)


NOT_SIMULATED = frozenset(  # functions of URScript that a program may call on a real arm, and not here
    (
        *("movec", "movep", "optimovej", "optimovel", "servoc", "direct_torque", "torque_command"),
        *("force_mode", "freedrive_mode", "teach_mode"),
        *("set_tool_voltage", "set_tool_communication", "ft_rtde_input_enable", "enable_external_ft_sensor"),
        *("get_mass_matrix", "get_coriolis_and_centrifugal_torques", "get_jacobian", "get_jacobian_time_derivative"),
        *("socket_open", "socket_close", "socket_send_string", "socket_read_string", "socket_read_ascii_float"),
        *("socket_read_binary_integer", "socket_get_var", "socket_set_var", "rpc_factory", "modbus_add_signal"),
        *("path_offset_enable", "path_offset_set", "track_conveyor_linear", "set_conveyor_tick_count"),
    )
)
