"""The friction laws in the help of a command. The registry is read when the help is needed: it imports numpy, which is slow."""

from typing import Any

from typer.core import TyperCommand

LAWS = "{laws}"  # in the help of an option: the names of the friction laws


class CommandWithLaws(TyperCommand):
    """A command in whose help the names of the laws of `model.friction` stand in the place of `LAWS`."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as they are asked for before arguments are parsed or help is printed."""
        parameters: list[Any] = super().get_params(ctx)
        for parameter in parameters:
            text = getattr(parameter, "help", None)
            if text and LAWS in text:
                from monitor.model.friction import law_choices

                parameter.help = text.replace(LAWS, law_choices())
        return parameters
