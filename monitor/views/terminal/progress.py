"""Progress on standard error while a person waits. Where standard error is no terminal, nothing is shown."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, float, float], None]]:
    """A bar for phases of known length, a spinner for others. Call what it yields with phase, elapsed and total time [s], 0 if unknown."""
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.1f} s"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=None)

        def show(phase: str, elapsed_s: float, duration_s: float) -> None:
            bar.update(task, description=f"{title}: {phase}", completed=elapsed_s, total=duration_s or None)

        yield show


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
