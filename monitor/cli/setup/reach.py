"""Which address the arm of a new configuration has, and what it says there."""

from typing import TYPE_CHECKING

import typer

from monitor.cli.setup.questions import Questions, text_of
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.acquire.survey import Survey


def reached(host: str | None, ask: Questions, *, simulated: bool, robot_api_port: int) -> tuple[str, "Survey"]:
    """The address of the controller, and what it says. One that a person gives and that does not answer is asked for once more.

    host : the option; None where it is not given. robot_api_port : of a PolyScope X. Raises BadInput where it is no address.
    """
    read, default = text_of(_address), "127.0.0.1" if simulated else "-"
    address = ask.answer("--host", host, "Address of the controller (- for none yet)", default, read)
    found = _survey(address, ask.asks, robot_api_port)
    while ask.asks and host is None and address != "-" and found.identity is None:
        again = ask.answer("--host", None, f"Address of the controller (Enter keeps {address}, - for none yet)", address, read)
        if again == address:
            break
        address, found = again, _survey(again, ask.asks, robot_api_port)
    return address, found


def _address(text: str) -> None:
    """Raises BadInput where a text is no address at which an arm would be moved; - is none yet."""
    from monitor.acquire.safety.of_configuration import local_address
    from monitor.errors import MotionRefused

    if text == "-":
        return
    try:
        local_address(text)
    except MotionRefused as error:
        raise BadInput(str(error)) from None


def _survey(address: str, asks: bool, robot_api_port: int) -> "Survey":
    """What the arm says, and a line for a person about it."""
    from monitor.acquire.driver import driver_of
    from monitor.acquire.survey import Survey, survey
    from monitor.views.terminal.progress import status

    if address == "-":
        return Survey()
    with status(f"asking {address}"):
        found = survey(address, driver=driver_of("universal_robots", robot_api_port=robot_api_port))
    if found.identity is not None:
        said = [found.model or "model unknown", f"serial {found.serial or 'unknown'}", f"software {found.identity.firmware or 'unknown'}"]
        typer.echo(f"{address} answers: {', '.join(said)}")
    if found.problem:
        stop = "" if found.problem.endswith("?") else "."
        typer.echo(f"{found.problem}{stop} What it does not say {'is asked' if asks else 'needs an option, or has its default'}.", err=True)
    return found
