"""The program files of a controller. They are in memory: two programs that a cell may run by itself, and the one that is loaded."""

from monitor.simulate.controller.program.language import Source
from monitor.simulate.controller.program.scripts import parse

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

    def __init__(self) -> None:
        self.loaded = SCRIPT_PROGRAM

    def load(self, path: str) -> bool:
        """Load a program. Returns False if there is no such file."""
        name = self._name(path)
        if name in PROGRAMS:
            self.loaded = name
        return name in PROGRAMS

    def has_installation(self, path: str) -> bool:
        """Whether there is an installation file of this name."""
        return self._name(path) in INSTALLATIONS

    @property
    def program(self) -> Source | None:
        """The loaded program; None if only scripts have run so far."""
        script = parse(PROGRAMS[self.loaded]) if self.loaded in PROGRAMS else None
        return script if isinstance(script, Source) else None

    @staticmethod
    def _name(path: str) -> str:
        folder, slash, name = path.rpartition("/")
        return name if folder + slash in FOLDERS else path
