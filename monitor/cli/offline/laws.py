"""The names of the friction laws in the help of a command.

The registry of laws imports numpy, which is slow. So it is read when a command is parsed, and not when the program starts.
"""

from typing import Any

from typer.core import TyperCommand

LAWS = "{laws}"  # stands in the help text of an option for the names of the friction laws


class CommandWithLaws(TyperCommand):
    """A command that replaces LAWS in its options' help by the names of the registered friction laws."""

    def get_params(self, ctx: Any) -> list[Any]:  # the types are private to typer
        """The parameters. Click calls this before it parses arguments or prints help."""
        parameters: list[Any] = super().get_params(ctx)
        for parameter in parameters:
            text = getattr(parameter, "help", None)
            if text and LAWS in text:
                from monitor.model.friction import law_choices

                parameter.help = text.replace(LAWS, law_choices())
        return parameters
