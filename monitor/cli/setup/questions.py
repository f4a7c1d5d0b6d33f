"""Questions to a person in a terminal, each with an option that answers it beforehand."""

from collections.abc import Callable
from typing import Any, TypeVar

import typer

from monitor.errors import BadInput

Answer = TypeVar("Answer")


class Questions:
    """Asks what no option has answered. With `ask` false nothing is asked: the default counts."""

    def __init__(self, ask: bool) -> None:
        self.asks = ask

    def say(self, text: str = "") -> None:
        """A sentence before a question; silent where nothing is asked."""
        if self.asks:
            typer.echo(text)

    def answer(self, option: str, given: Any, question: str, default: Any, read: Callable[[str], Answer]) -> Answer:
        """The answer to one question: the option's, else the person's, else the default.

        read : makes the answer of a text; raises BadInput where it is none. default : as text; None: there is none.

        Raises BadInput where the option is wrong, where there is no answer, and where nobody is there to give one.
        """
        if given is not None:
            return _of_option(option, str(given), read)
        if not self.asks:
            if default is None:
                raise BadInput(f"{option} is missing ({question}), and --no-input asks nobody; nothing was written")
            return _of_option(option, str(default), read)
        try:
            text: Answer = typer.prompt(question, default=default, value_proc=lambda text: _checked(text, read))
        except typer.Abort:
            typer.echo(err=True)
            raise BadInput(f"no answer to {question!r}, nothing was written; {option} answers it, --no-input asks nothing") from None
        return text

    def confirm(self, option: str, given: bool | None, question: str, *, default: bool) -> bool:
        """A yes or a no. Raises BadInput where nobody is there to give one."""
        if given is not None or not self.asks:
            return default if given is None else given
        try:
            return typer.confirm(question, default=default)
        except typer.Abort:
            typer.echo(err=True)
            raise BadInput(f"no answer to {question!r}, nothing was written; {option} answers it, --no-input asks nothing") from None


def _of_option(option: str, text: str, read: Callable[[str], Answer]) -> Answer:
    try:
        return read(text)
    except BadInput as error:
        raise BadInput(f"{option}: {error}") from None


def _checked(text: str, read: Callable[[str], Answer]) -> Answer:
    """The answer, or an error after which the question is asked again."""
    try:
        return read(text)
    except BadInput as error:
        raise typer.BadParameter(str(error)) from None


def text_of(allowed: Callable[[str], object] | None = None) -> Callable[[str], str]:
    """Reads a text. allowed : raises BadInput for a text that is not."""

    def read(text: str) -> str:
        text = text.strip()
        if allowed is not None:
            allowed(text)
        return text

    return read


def number_from(least: float, most: float) -> Callable[[str], float]:
    """Reads a number from least to most."""

    def read(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            raise BadInput(f"{text!r} is no number; expected {least:g} to {most:g}") from None
        if not least <= number <= most:
            raise BadInput(f"{text} is outside of {least:g} to {most:g}")
        return number

    return read


def numbers(count: int, what: str) -> Callable[[str], tuple[float, ...]]:
    """Reads so many comma-separated numbers, or none at all."""

    def read(text: str) -> tuple[float, ...]:
        from monitor.cli.options import figures

        return () if text.strip() in {"", "-"} else tuple(figures(text, "the answer", count, what).tolist())

    return read


def listed(values: tuple[float, ...]) -> str:
    """Figures as an answer that can be typed; - for none."""
    return ",".join(f"{value:g}" for value in values) or "-"
