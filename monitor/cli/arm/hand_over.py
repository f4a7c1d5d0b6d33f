"""The command `script-node`, which writes the text of a program's node as a file for the controller."""

from pathlib import Path
from typing import Annotated

import typer

from monitor.cli.options import Commands, ConfigOption, ForceOption, JsonOption, load_configuration, print_json, refuse_overwriting
from monitor.errors import BadInput

SUFFIX = ".script"  # PolyScope lists only such files for a Script node


def script_node(
    config: ConfigOption,
    output: Annotated[Path, typer.Option("--output", "-o", help=f"Where the text goes ({SUFFIX}).", show_default=False)],
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the text with which a Script node of your program lends the arm; it is made for the controller that answers now."""
    from monitor.service.node import keep, node_text

    configuration = load_configuration(config)
    if output.suffix != SUFFIX:
        raise BadInput(f"{output}: PolyScope reads a Script node's text from a file that ends in {SUFFIX}; give such a name")
    if not output.parent.is_dir():
        raise BadInput(f"{output}: the folder {output.parent} does not exist")
    node = node_text(configuration.robot.host, driver=configuration.driver)
    there = _text_of(output)
    same = there == node.text
    if there is not None and not same:
        refuse_overwriting(output, force)
    if not same:
        try:
            output.write_text(node.text, "utf-8")
        except OSError as error:
            raise BadInput(f"{output}: {error.strerror}") from None
    keep(configuration.state_directory, node)
    lines = node.text.count("\n")
    if as_json:
        print_json(
            {
                "file": str(output),
                "number": node.number,
                "software": node.software,
                "host": configuration.robot.host,
                "lines": lines,
                "written": not same,
                "hand_over": configuration.replay.hand_over,
            }
        )
        return
    typer.echo(f"{output}: {'is right already' if same else 'written'}: node {node.number}, {lines} lines, software {node.software or '?'}")
    if configuration.replay.hand_over != "script_node":
        typer.echo(f'  it takes effect with [replay] hand_over = "script_node"; now it is "{configuration.replay.hand_over}"')


def _text_of(path: Path) -> str | None:
    """What a file holds already; None where there is none. Raises BadInput where it cannot be read."""
    try:
        return path.read_text("utf-8", errors="replace") if path.exists() else None
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None


COMMANDS: Commands = {"script-node": script_node}
