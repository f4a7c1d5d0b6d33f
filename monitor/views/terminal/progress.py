"""Progress on standard error while a person waits: a bar on a terminal, elsewhere a line now and then."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

LINE_EVERY_S = 5.0  # where there is no terminal: a person who reads a log should not wait longer in silence


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, float, float], None]]:
    """A bar for phases of known length, a spinner for others. Call what it yields with phase, elapsed and total time [s], 0 if unknown.

    Where standard error is no terminal, a line comes every LINE_EVERY_S.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(title)
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=None)

        def show(phase: str, elapsed_s: float, duration_s: float) -> None:
            bar.update(task, description=progress_text(title, phase, elapsed_s, duration_s), completed=elapsed_s, total=duration_s or None)

        yield show


def progress_text(title: str, phase: str, elapsed_s: float, duration_s: float) -> str:
    """Where something is, e.g. `replay: slow first pass, 40 s of 52`."""
    total = f" of {duration_s:.0f}" if duration_s else ""
    return f"{title}: {phase}, {elapsed_s:.0f} s{total}"


def _lines(title: str) -> Callable[[str, float, float], None]:
    shown_at = time.monotonic()

    def show(phase: str, elapsed_s: float, duration_s: float) -> None:
        nonlocal shown_at
        if time.monotonic() - shown_at >= LINE_EVERY_S:
            shown_at = time.monotonic()
            print(progress_text(title, phase, elapsed_s, duration_s), file=sys.stderr, flush=True)  # noqa: T201

    return show


@contextmanager
def status(text: str) -> Iterator[None]:
    """A spinner while something is computed."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(text):
        yield


@contextmanager
def search_progress(title: str, budget: int) -> Iterator[Callable[[int, float], None]]:
    """A bar over a budget of evaluations. Call what it yields with the evaluations done and the best value, inf before there is one."""
    console = Console(stderr=True)
    text = TextColumn("{task.description}  best {task.fields[best]}")
    columns = (SpinnerColumn(), text, BarColumn(), TextColumn("{task.completed:.0f} of {task.total:.0f}"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=budget, best="–")

        def show(done: int, best: float) -> None:
            bar.update(task, completed=done, best=f"{best:.4g}" if best < float("inf") else "none allowed yet")

        yield show


@contextmanager
def campaign_progress(robots: Sequence[str]) -> Iterator[Callable[[str, str, float], None]]:
    """A bar for each robot. Call what it yields with the robot, what is done now, and the fraction of its campaign that is done."""
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.fields[robot]}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %  {task.description}"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        tasks = {name: bar.add_task("waiting", total=1.0, robot=name) for name in robots}

        def show(robot: str, doing: str, share: float) -> None:
            bar.update(tasks[robot], completed=share, description=doing)

        yield show


@contextmanager
def count_progress(title: str, unit: str) -> Iterator[Callable[[str, int, int], None]]:
    """A bar over a known number of things. Call what it yields with what is done now, how many are done, and how many there are.

    Where standard error is no terminal, a line comes every LINE_EVERY_S.
    """
    console = Console(stderr=True)
    shown_at = time.monotonic()

    def line(phase: str, done: int, total: int) -> None:
        nonlocal shown_at
        if time.monotonic() - shown_at >= LINE_EVERY_S:
            shown_at = time.monotonic()
            print(f"{title}: {done} of {total} {unit}, {phase}", file=sys.stderr, flush=True)  # noqa: T201

    if not console.is_terminal:
        yield line
        return
    text = TextColumn("{task.completed:.0f} of {task.total:.0f} {task.fields[unit]}, {task.fields[phase]}")
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), text, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task(title, total=1, unit=unit, phase="")
        yield lambda phase, done, total: bar.update(task, phase=phase, completed=done, total=total)
