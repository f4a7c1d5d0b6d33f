"""The address space of the server: the nodesets, then the nodes of sites and arms, put in, written and taken out. I/O.

Works in the server's event loop. Attributes that thousands of nodes have in common are one object, so that an arm takes a third of the
memory.
"""

import logging
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

from monitor.gateway.opcua.nodes import HAS_COMPONENT, ORGANIZES, OWN, Node, Reading, Ref, arm_nodes, readings, site_nodes
from monitor.plant.arm import ArmName, HeardArm

if TYPE_CHECKING:
    from asyncua import Server

NODESETS = ("Di", "IA", "Machinery", "Robotics")  # each needs those before it
FOUNDATION = "http://opcfoundation.org/UA/"
UNITS = "http://www.opcfoundation.org/UA/units/un/cefact"
_SCHEMA = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"


class Present(NamedTuple):
    """An arm whose nodes are there."""

    nodes: list[Node]
    variables: dict[str, Node]  # by id
    said: dict[str, Reading]  # what was written last
    joints: tuple[int, ...]


class AddressSpace:
    """Nodes of one server."""

    def __init__(self, server: "Server") -> None:
        self._server = server
        self._session = server.iserver.isession
        self._spaces: dict[str, int] = {}
        self._sites: dict[str, list[Node]] = {}
        self._arms: dict[ArmName, Present] = {}
        self._shared: dict[tuple[Any, str], Any] = {}
        self._ids: dict[Ref, Any] = {}

    async def prepare(self) -> None:
        """Import the nodesets."""
        with _quiet("asyncua.common.xmlimporter"):  # it warns of placeholders that two types share: they are meant so
            for name in NODESETS:
                await self._server.import_xml(xmlstring=nodeset(name))
        await self._server.register_namespace(OWN)
        uris = await self._server.get_namespace_array()
        self._spaces = {uri.removeprefix(FOUNDATION): k for k, uri in enumerate(uris)}

    @property
    def arms(self) -> set[ArmName]:
        """Those that are there."""
        return set(self._arms)

    async def put(self, arm: HeardArm, now_unix_s: float, bad_after_s: float) -> int:
        """Make an arm's nodes where they are not there, and write what has changed. Returns how many values were written."""
        name, joints = arm.name, tuple(joint.joint for joint in arm.joints)
        present = self._arms.get(name)
        if present is not None and present.joints != joints:
            await self.take_out(name)
            present = None
        if present is None:
            if name.site not in self._sites:
                self._sites[name.site] = await self._add(site_nodes(name.site))
            nodes = await self._add(arm_nodes(arm))
            present = Present(nodes, {node.id: node for node in nodes if node.data is not None}, {}, joints)
            self._arms[name] = present
        told = readings(arm, now_unix_s, bad_after_s)
        changed = {key: reading for key, reading in told.items() if present.said.get(key) != reading}
        for key, reading in changed.items():
            await self._write(present.variables[key], reading)
        present.said.update(changed)
        return len(changed)

    async def take_out(self, name: ArmName) -> None:
        """Remove an arm's nodes, and every reference to them; those of its site as well where it was the last one there."""
        await self._remove(self._arms.pop(name).nodes)
        if not any(each.site == name.site for each in self._arms):
            await self._remove(self._sites.pop(name.site))

    async def _remove(self, nodes: list[Node]) -> None:
        from asyncua import ua

        own = {node.id for node in nodes}
        ends = [(HAS_COMPONENT, node.parent, node.id) for node in nodes if node.parent not in own]
        ends += [(ORGANIZES, node.organized_by, node.id) for node in nodes if node.organized_by]
        back = [(kind, target, node.id) for node in nodes for kind, target in node.links if target not in own]
        cut = [(place, kind, True, node) for kind, place, node in ends] + [(place, kind, False, node) for kind, place, node in back]
        await self._session.delete_references(
            [ua.DeleteReferencesItem(self._id(place), self._id(kind), forward, self._id(node), False) for place, kind, forward, node in cut]
        )
        gone = [ua.DeleteNodesItem(self._id(node.id), DeleteTargetReferences=False) for node in reversed(nodes)]
        await self._session.delete_nodes(ua.DeleteNodesParameters(gone))

    async def _add(self, made: Iterable[Node]) -> list[Node]:
        from asyncua import ua

        nodes = list(made)
        for result, node in zip(await self._session.add_nodes([self._item(node) for node in nodes]), nodes, strict=True):
            if not result.StatusCode.is_good():
                raise RuntimeError(f"{node.id}: {result.StatusCode.name}")
        links: list[tuple[str | Ref, Ref, str | Ref]] = [(node.id, kind, target) for node in nodes for kind, target in node.links]
        links += [(node.organized_by, ORGANIZES, node.id) for node in nodes if node.organized_by]
        both = [(link[0], link[1], link[2], True) for link in links] + [(link[2], link[1], link[0], False) for link in links]
        added = [ua.AddReferencesItem(self._id(a), self._id(kind), forward, None, self._id(b)) for a, kind, b, forward in both]
        for status in await self._session.add_references(added):
            status.check()
        for node in nodes:
            if node.data is not None:
                await self._write(node, Reading(node.unit or node.value, node.status, None))
            self._share(self._id(node.id))
        return nodes

    def _item(self, node: Node) -> Any:
        """A new node, whose value is written afterwards."""
        from asyncua import ua

        made = ua.AddNodesItem()
        made.RequestedNewNodeId, made.ParentNodeId = self._id(node.id), self._id(node.parent)
        made.ReferenceTypeId, made.TypeDefinition = self._id(node.reference), self._id(node.type)
        made.BrowseName = ua.QualifiedName(node.name, self._spaces[node.namespace])
        if node.data is None:
            made.NodeClass, made.NodeAttributes = ua.NodeClass.Object, ua.ObjectAttributes()
        else:
            made.NodeClass, made.NodeAttributes = ua.NodeClass.Variable, ua.VariableAttributes()
            made.NodeAttributes.DataType, made.NodeAttributes.ValueRank = self._id(node.data.type), ua.ValueRank.Scalar
            made.NodeAttributes.AccessLevel = made.NodeAttributes.UserAccessLevel = ua.AccessLevel.CurrentRead.mask
        made.NodeAttributes.DisplayName = ua.LocalizedText(node.name)
        return made

    async def _write(self, node: Node, reading: Reading) -> None:
        from asyncua import ua

        at = reading.at_unix_s
        value = ua.DataValue(
            ua.Variant(None, ua.VariantType.Null) if reading.value is None else _variant(node, reading.value),
            ua.StatusCode(getattr(ua.StatusCodes, reading.status)),
            SourceTimestamp=datetime.fromtimestamp(at, UTC) if at is not None else None,
            ServerTimestamp=datetime.now(UTC),
        )
        (await self._server.iserver.aspace.write_attribute_value(self._id(node.id), ua.AttributeIds.Value, value)).check()

    def _share(self, node_id: Any) -> None:
        """Use one object for each attribute that is the same as another node's. Only values are ever written, and these are not shared."""
        from asyncua import ua

        attributes = self._server.iserver.aspace[node_id].attributes
        for key, kept in attributes.items():
            if key not in {ua.AttributeIds.Value, ua.AttributeIds.NodeId}:
                attributes[key] = self._shared.setdefault((key, repr(kept.value)), kept)

    def _id(self, place: "str | Ref | None") -> Any:
        from asyncua import ua

        if isinstance(place, Ref):
            if place not in self._ids:
                self._ids[place] = ua.NodeId(place.number, self._spaces[place.namespace])
            return self._ids[place]
        return ua.NodeId(place, self._spaces[OWN])


def _variant(node: Node, value: object) -> Any:
    from asyncua import ua

    built_in = node.data.built_in if node.data is not None else "String"
    if node.unit is not None:
        about = node.unit
        said = ua.EUInformation(UNITS, about.number, ua.LocalizedText(about.symbol), ua.LocalizedText(about.name))
        return ua.Variant(said, ua.VariantType.ExtensionObject)
    if built_in == "LocalizedText":
        value = ua.LocalizedText(str(value))
    elif built_in == "DateTime" and isinstance(value, float | int):
        value = datetime.fromtimestamp(value, UTC)
    return ua.Variant(value, getattr(ua.VariantType, built_in))


def nodeset(name: str) -> bytes:
    """A nodeset as a server has it: without the nodes that are for tools that design models (`DesignToolOnly`)."""
    ET.register_namespace("", _SCHEMA[1:-1])
    root = ET.fromstring((files("monitor.gateway.opcua") / "nodesets" / f"Opc.Ua.{name}.NodeSet2.xml").read_bytes())  # noqa: S314 - our own file
    left_out = {node.get("NodeId") for node in root if node.get("DesignToolOnly") == "true"}
    for node in list(root):
        if node.get("NodeId") in left_out:
            root.remove(node)
        for references in node.findall(f"{_SCHEMA}References"):
            for reference in [each for each in references if each.text in left_out]:
                references.remove(reference)
    return ET.tostring(root)


@contextmanager
def _quiet(*names: str) -> Iterator[None]:
    """Let loggers say errors alone."""
    loggers = [logging.getLogger(name) for name in names]
    before = [each.level for each in loggers]
    for each in loggers:
        each.setLevel(logging.ERROR)
    try:
        yield
    finally:
        for each, level in zip(loggers, before, strict=True):
            each.setLevel(level)
