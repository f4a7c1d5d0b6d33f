"""One run of the golden set: where it writes, where it works, and how it calls the command line."""

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import chdir
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

from . import at, worlds
from .normalise import normalised

ROOT = Path(__file__).parents[2]


def data_folder() -> Path | None:
    """Of the real recordings, which are not ours to ship; None where they are absent."""
    folder = Path(os.environ.get("JOINT_MONITOR_DATA", ROOT.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


@dataclass
class Run:
    """What one regeneration shares between its parts."""

    into: Path  # what is compared
    production: Path  # scratch
    artefacts: Path  # kept for those who come later: recordings, history_of_today
    earlier: Path | None = None  # an earlier set whose history is continued; None: this one's
    simulate: bool = True  # else the recordings of the earlier set are taken
    here: bool = False  # whether commands run in this process, which has imported what they need
    _recorded: dict[str, Path] = field(default_factory=dict)
    _commands: "subprocess.Popen[str] | None" = None

    @property
    def history_of_today(self) -> Path:
        """The state directory, with its configuration beside it, that is continued."""
        return (self.earlier or self.artefacts) / "history_of_today"

    def world(self, name: str) -> Path:
        """The folder of one arm's recordings, made once a run."""
        if name not in self._recorded:
            folder = self.artefacts / "recordings" / name
            if not self.simulate and self.earlier is not None:
                folder = self.earlier / "recordings" / name
            else:
                worlds.recorded(worlds.WORLDS[name], folder)
            self._recorded[name] = folder
        return self._recorded[name]

    def clean(self, text: str) -> str:
        """Without what means nothing."""
        places = {self.production: "<work>", self.artefacts: "<artefacts>", self.into: "<into>"}
        if self.earlier is not None:
            places[self.earlier] = "<artefacts>"
        if (data := data_folder()) is not None:
            places[data] = "<data>"
        return normalised(text, {**places, ROOT: "<root>"})

    def put(self, name: str, document: Any) -> None:
        """One JSON file of the set."""
        self._write(name, json.dumps(document, ensure_ascii=False, indent=1) + "\n")

    def put_lines(self, name: str, documents: Iterable[Any]) -> None:
        """One file of the set with a JSON document a line."""
        self._write(name, "".join(json.dumps(document, ensure_ascii=False) + "\n" for document in documents))

    def put_text(self, name: str, text: str) -> None:
        """One file of the set as it is."""
        self._write(name, text)

    def _write(self, name: str, text: str) -> None:
        path = self.into / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.clean(text), "utf-8")

    def command(self, name: str, *arguments: str | Path, cwd: Path, at_unix_s: float, files: Sequence[Path] = ()) -> None:
        """One command into one file: its exit code, its output by stream, and the files that it wrote."""
        argv = [str(argument) for argument in arguments]
        done = self._done({"command": argv, "cwd": str(cwd), "at_unix_s": at_unix_s})
        if not isinstance(done["exit"], int):
            print(f"  {name}: {done['exit']}")
        document: dict[str, Any] = {
            "command": [self.clean(each) for each in argv],
            "exit": done["exit"],
            "stdout": self.clean(done["stdout"]).splitlines(),
            "stderr": self.clean(done["stderr"]).splitlines(),
        }
        if files:
            document["files"] = {path.name: self.clean(path.read_text("utf-8")).splitlines() if path.is_file() else None for path in files}
        self.put(name, document)

    def _done(self, asked: dict[str, Any]) -> dict[str, Any]:
        if self.here:
            with chdir(Path.cwd()), patch.object(sys, "argv", sys.argv), at.stopped_clock():
                return at.answer(asked)
        if self._commands is None:
            self._commands = subprocess.Popen(
                [sys.executable, "-m", "tests.golden.at"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment()
            )
        assert self._commands.stdin is not None
        assert self._commands.stdout is not None
        self._commands.stdin.write(json.dumps(asked) + "\n")
        self._commands.stdin.flush()
        line = self._commands.stdout.readline()
        if not line:
            raise RuntimeError(f"the command line ended in the middle of {asked['command']}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """End the process that does the commands."""
        if self._commands is not None:
            self._commands.communicate()
            self._commands = None


def environment() -> dict[str, str]:
    """Of a command: one thread, this checkout's code, a page's width, no setting of whoever runs it."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("JOINT_MONITOR__")}
    fixed = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "COLUMNS": "140", "NO_COLOR": "1", "TZ": "UTC", "TERM": "dumb"}
    return {**kept, **fixed}
