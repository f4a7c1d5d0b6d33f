"""The program files of a controller. They are in memory: two programs that a cell may run by itself, and the one that is loaded."""

from collections.abc import Mapping

from monitor.simulate.controller.program.language import Source
from monitor.simulate.controller.program.scripts import Refused, parse
from monitor.simulate.program_tree import Host, ProgramTree

FOLDERS = ("", "/programs/", "/ursim/programs/")  # where a file may be said to be: on an arm, and in the manufacturer's own simulator
INSTALLATIONS = frozenset({"default.installation"})
SCRIPT_PROGRAM = "rtde_control.urp"  # what is loaded at first; programs that come over a script port are reported under the loaded name
PROGRAMS = {  # file name → what it does
    "wait_program.urp": "def wait_program():\n  while True:\n    sleep(1.0)\n  end\nend",
    "back_and_forth.urp": (
        "def back_and_forth():\n"
        "  here = get_target_joint_positions()\n"
        "  there = here + [0, 0, 0, 0, 0, 0.4]\n"
        "  while True:\n"
        "    movej(there, a=1.0, v=0.5)\n"
        "    movej(here, a=1.0, v=0.5)\n"
        "  end\n"
        "end"
    ),
}


class ProgramFiles:
    """The files of one controller. `loaded` is the name of the loaded program."""

    def __init__(self, tree: ProgramTree | None = None, *, silent: bool = False, of_cell: str | None = None) -> None:
        """A production program is loaded at first if one is given. `silent`: a node whose host does not answer does nothing.

        of_cell : name of the program of the cell around the arm, which is then loaded at first; None if the arm stands in none.
        """
        self._of_cell = None if of_cell is None else f"{of_cell}.urp"
        self._silent = silent
        self._trees = {} if tree is None else {f"{tree.name}.urp": tree}
        self.loaded = self._of_cell or next(iter(self._trees), SCRIPT_PROGRAM)
        self._served: Mapping[Host, str | None] = {}

    def load(self, path: str) -> bool:
        """Load a program. Returns False if there is no such file."""
        name = self._name(path)
        found = name in self.names
        if found:
            self.loaded = name
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all program files."""
        return (*(() if self._of_cell is None else (self._of_cell,)), *self._trees, *PROGRAMS)

    @property
    def cell_loaded(self) -> bool:
        """Whether the program of the cell is the one that is loaded."""
        return self.loaded == self._of_cell

    @property
    def hosts(self) -> tuple[Host, ...]:
        """The hosts that the loaded program asks for text at Play."""
        return self._trees[self.loaded].hosts if self.loaded in self._trees else ()

    def serve(self, served: Mapping[Host, str | None]) -> None:
        """Take over what the hosts answered; None where one did not."""
        self._served = served

    def has_installation(self, path: str) -> bool:
        """Whether there is an installation file of this name."""
        return self._name(path) in INSTALLATIONS

    @property
    def program(self) -> Source | Refused | None:
        """The loaded program, made into a script as at Play; None if only scripts have run so far."""
        if self.loaded in self._trees:
            text = self._trees[self.loaded].script(self._served, silent=self._silent)
        elif self.loaded in PROGRAMS:
            text = PROGRAMS[self.loaded]
        else:
            return None
        script = parse(text, recognise=False)
        return script if isinstance(script, Source | Refused) else None

    @staticmethod
    def _name(path: str) -> str:
        folder, slash, name = path.rpartition("/")
        return name if folder + slash in FOLDERS else path
