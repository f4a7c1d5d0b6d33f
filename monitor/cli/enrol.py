"""The words `plant enrol` and `plant check`: from an inventory to the files of many arms, and what each of them lacks."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monitor.cli.options import Commands, JsonOption, print_json
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.plant.enrol.authority import Issued
    from monitor.plant.enrol.check import Lack
    from monitor.plant.enrol.files import Plant, Written

InventoryArgument = Annotated[Path, typer.Argument(metavar="INVENTORY.csv", help="One row an arm: site, id, model, host and more.")]

IntoOption = Annotated[Path, typer.Option("--into", help="The plant's folder.")]

RouterOption = Annotated[list[str] | None, typer.Option(metavar="SITE=ENDPOINT", help="Router of a site, e.g. hall-1=tls/hall-1:7447.")]

CoreOption = Annotated[str, typer.Option(help="Endpoint of the router between the sites.")]


def enrol(
    inventory: InventoryArgument,
    into: IntoOption = Path("plant"),
    router: RouterOption = None,
    core: CoreOption = "",
    authority: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="CERTIFICATE KEY", help="An authority of yours (PEM); else the folder's own.", show_default=False),
    ] = None,
    days: Annotated[int, typer.Option(help="How long certificates hold.")] = 825,
    force: Annotated[bool, typer.Option("--force", help="Replace configurations that differ from the inventory.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write configurations, certificates and access control of all arms of an inventory. Again: what is new or near its end."""
    from monitor.plant.enrol import files

    plant = _plant(inventory, router, core, days)
    root = None if authority is None else _own(*authority)
    written = files.enrol(plant, into, root=root, force=force)
    if as_json:
        print_json(_written_document(written, into, plant))
    else:
        _print_written(written, into, plant)


def check(
    inventory: InventoryArgument,
    into: IntoOption = Path("plant"),
    router: RouterOption = None,
    core: CoreOption = "",
    offline: Annotated[bool, typer.Option("--offline", help="Files alone: no router is asked.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Tell which arm lacks what: its configuration, its certificate, and what its monitor says. Exit 3: some arm lacks something."""
    from monitor.plant.enrol.check import ask_all, joined, lacks_of_files, lacks_on_bus

    plant = _plant(inventory, router, core)
    now = datetime.now(UTC)
    parts = [lacks_of_files(plant, into, now)]
    if not offline:
        parts.append(lacks_on_bus(plant, ask_all(plant, into), now))
    found = joined(plant.arms, *parts)
    if as_json:
        print_json({name: [{"cause": lack.cause, "text": lack.text} for lack in lacks] for name, lacks in found.items()})
    else:
        _print_lacks(found)
    raise typer.Exit(3 if any(found.values()) else 0)


def _plant(inventory: Path, routers: list[str] | None, core: str, days: int = 825) -> "Plant":
    from monitor.plant.enrol.files import Plant
    from monitor.plant.enrol.inventory import read_inventory

    try:
        text = inventory.read_text("utf-8-sig")
    except OSError as error:
        raise BadInput(f"{inventory}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise BadInput(f"{inventory}: is no UTF-8; save the table as CSV in UTF-8") from None
    by_site = {}
    for each in routers or []:
        site, sign, endpoint = each.partition("=")
        if not sign or site in by_site:
            raise BadInput(f"--router {each}: expected SITE=tls/HOST:PORT, once for each site")
        by_site[site] = endpoint
    return Plant(arms=read_inventory(text, str(inventory)), routers=by_site, core=core, days=days)


def _own(certificate: Path, key: Path) -> "Issued":
    from monitor.plant.enrol.authority import Issued

    try:
        return Issued(certificate.read_bytes(), key.read_bytes())
    except OSError as error:
        raise BadInput(f"{error.filename}: cannot be read: {error.strerror}") from None


def _written_document(written: "Written", into: Path, plant: "Plant") -> dict[str, object]:
    return {
        "folder": str(into),
        "arms": [arm.name for arm in plant.arms],
        "new": written.new,
        "changed": written.changed,
        "kept": written.kept,
        "same": written.same,
        "gone": written.gone,
    }


def _print_written(written: "Written", into: Path, plant: "Plant") -> None:
    typer.echo(
        f"{into}: {len(plant.arms)} arms; {len(written.new)} files are new, {len(written.changed)} changed, {written.same} as they were"
    )
    for name in written.kept:
        typer.echo(f"  kept as it is, though the inventory says otherwise: {name} (--force replaces it)")
    for name in written.gone:
        typer.echo(f"  no longer in the inventory, and its certificate opens nothing any more: {name}")
    if written.new or written.changed:
        typer.echo("Next: copy each folder of computers/ into /etc/joint-monitor of that computer, those of routers/ to the routers;")
        typer.echo("keys (*.key) for the service's user alone; keep authority/ca.key where nobody else reads it.")


def _print_lacks(found: "dict[str, list[Lack]]") -> None:
    for name, lacks in found.items():
        for lack in lacks:
            typer.echo(f"{name}: {lack.cause}: {lack.text}")
    whole = sum(not lacks for lacks in found.values())
    typer.echo(f"{whole} of {len(found)} arms lack nothing")


WORDS: Commands = {"enrol": enrol, "check": check}
