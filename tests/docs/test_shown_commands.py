"""The commands that the pages show are run, in the life of one simulated arm, and what they print has the shape that the pages show.

Shape: the lines of a page stand in the output, in their order, whatever the figures, dates and widths. A line `…` is not compared.
"""

import io
import json
import re
import shutil
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import pytest
from doc_pages import ROOT, Shown, shown

from monitor.cli.main import main
from monitor.model.fourier import excitation_from_document
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording

pytestmark = pytest.mark.timeout(300)

NOT_RUN = {  # by the command, or by its first words
    "simulate --": "goes on until Ctrl-C",
    "run --config config/simulated.toml": "goes on until it is stopped",
    "simulate-plant": "goes on until Ctrl-C; the tests of the plant run it",
    "plant": "goes on until it is stopped, or needs arms; the tests of the plant run it, and compare what the page shows",
    "gateway": "needs a plant and servers; the tests of the gateway run it, and compare what the page shows",
    "watch": "asks a running daemon, and goes on until Ctrl-C",
    "check": "asks a controller",
    "script-node": "asks a controller; the tests of the service run it",
    "replay": "moves an arm, in real time",
    "campaign": "asks a running daemon; the tests of the service run it",
    "--install-completion": "writes into the start-up file of a person's shell",
    "record": "listens to an arm, in real time",
    "allow": "needs a stop that waits for a person",
    "try": "starts a daemon; the tests of the studies run it",
    "serviced --config trial": "speaks with the daemon of that trial",
    "reassess": "starts a process a core; the tests of the studies run it",
    "prior": "needs the histories of a fleet; the tests of the studies run it",
    "rehearse": "takes a minute; the tests of the studies play a smaller fleet",
}
INSTEAD = {  # makes a command quick, or reads the history instead of a daemon
    "--evaluations 3000": "--evaluations 100",
    "predict": "predict --local",
}
OUTPUTS = {"-o", "--plot", "--export"}
ENDS_WITH = {"run --config bad.toml": 78}
OF_A_DAEMON = re.compile(r"monitor \d|  up \d")  # lines of `status` that exist only after a daemon has run
OF_THEN = re.compile(r" then(?=, model )")  # pages show `status` beside a daemon; none runs beside these tests
BAD = '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n\n[schedule]\ntimezone = "UTC"\ncron = "at noon"\nblackot = []\n'
# the last three days: a history of a week ago would be STALE
RECORDED = [datetime.now(UTC).replace(hour=1, minute=30, second=35, microsecond=0) - timedelta(days=ago) for ago in (3, 2, 1)]
FIGURE = re.compile(r"[+-]?\d[\d.,]*(?:e[+-]?\d+)?")
DAY = re.compile(r"\b(?:Mon|Tue|Wed|Thu|Fri|Sat|Sun)\b")


def shape(line: str) -> str:
    """The line without figures, days and widths."""
    return re.sub(r"\s+", " ", re.sub(r"[━─]+", "━", DAY.sub("Day", FIGURE.sub("#", line)))).strip()


def run(folder: Path, words: list[str]) -> tuple[int, str]:
    """Exit code and output of `joint-monitor …`, called in that folder."""
    output, argv = io.StringIO(), sys.argv
    for option, value in pairwise(words):
        if option in OUTPUTS:  # another page may show a command that writes the same file
            (folder / value).unlink(missing_ok=True)
    sys.argv = ["joint-monitor", *words]
    try:
        with chdir(folder), redirect_stdout(output), redirect_stderr(output):
            main()
    except SystemExit as end:
        return int(end.code or 0), output.getvalue()
    finally:
        sys.argv = argv
    return 0, output.getvalue()


@pytest.fixture(scope="module")
def life(tmp_path_factory):
    """A folder as the pages assume it: configurations, three recordings of three days, and a history that imported them."""
    folder = tmp_path_factory.mktemp("life")
    shutil.copytree(ROOT / "config", folder / "config")
    (folder / "bad.toml").write_text(BAD)
    excitation = excitation_from_document(json.loads((ROOT / "config/excitation/ur5-ground.json").read_text("utf-8")))
    controller, rows = Controller(SimulateSettings(robot="ur5", seed=4)), ["file,recorded_at"]
    for number, recorded in enumerate(RECORDED):
        controller.pass_time(23.5, 20.0 + 3.0 * number, 0.3)
        recording = stepped_replay(controller, replace(excitation, repetitions=1))
        context = replace(recording.context, recorded_at_unix_s=recorded.timestamp())
        write_recording(folder / f"day-{number + 1}.parquet", replace(recording, context=context))
        rows.append(f"day-{number + 1}.parquet,{recorded:%Y-%m-%dT%H:%M:%SZ}")
    (folder / "days.csv").write_text("\n".join(rows) + "\n")
    code, output = run(folder, ["import", "--config", "config/simulated.toml", "--manifest", "days.csv"])
    assert code == 0, output
    return folder


def real_recordings(request: pytest.FixtureRequest, folder: Path, each: Shown) -> None:
    """The public recordings that a page names, and the manifest that it shows; skipped if they are absent."""
    names = [word for word in each.words if word.startswith("ur-")]
    if "runs.csv" in each.words:
        page = (ROOT / each.page).read_text("utf-8")
        manifest = re.search(r"^file,recorded_at\n(?:.+,.+\n)+", page, re.MULTILINE)[0]
        (folder / "runs.csv").write_text(manifest)
        names += [row.partition(",")[0] for row in manifest.splitlines()[1:]]
    for name in names:
        if not (folder / name).exists():
            (folder / name).symlink_to(request.getfixturevalue("real_data") / "ur10e" / name)


OURS = [each for each in shown() if each.words[0] == "joint-monitor"]
QUICK = [each for each in OURS if not any(" ".join(each.words[1:]).startswith(words) for words in NOT_RUN)]


@pytest.mark.parametrize("each", QUICK, ids=lambda each: f"{Path(each.page).stem}: {each.line[14:60]}")
def test_a_shown_command_prints_what_its_page_shows(each: Shown, life: Path, request: pytest.FixtureRequest, monkeypatch):
    """The command runs unchanged, or with a smaller search."""
    real_recordings(request, life, each)
    monkeypatch.setenv("COLUMNS", "120")  # the width of the pages
    line = each.line.removeprefix("joint-monitor ")
    for shown_words, words in INSTEAD.items():
        line = line.replace(shown_words, words)
    code, output = run(life, each._replace(line=line).words)
    assert code == ENDS_WITH.get(line, 0), output
    printed = iter([shape(OF_THEN.sub("", row)) for row in output.splitlines()])
    for row in each.output:
        if row.strip() not in {"", "…"} and not OF_A_DAEMON.match(row):
            assert shape(row) in printed, f"{each.page} shows {row!r}; printed is\n{output}"


def test_most_of_what_the_pages_show_is_run():
    """Every command that is not run has a reason, and every reason belongs to a shown command."""
    assert len(QUICK) >= 14
    lines = [" ".join(each.words[1:]) for each in OURS]
    assert all(any(line.startswith(words) for line in lines) for words in NOT_RUN)
    assert set(ENDS_WITH) <= set(lines)
