"""What the nodesets ask of instances, read from the OPC Foundation's XML by a parser that knows nothing of the server.

A type asks for its own mandatory members and for those of the types that it is a subtype of; an instance declaration may ask for members of
its own. A mandatory placeholder asks for at least one member of its type.
"""

import xml.etree.ElementTree as ET
from collections import defaultdict
from importlib.resources import files
from typing import NamedTuple

FOUNDATION = "http://opcfoundation.org/UA/"
SCHEMA = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"
MANDATORY, MANDATORY_PLACEHOLDER = "0:78", "0:11510"


class Declared(NamedTuple):
    """A node of a nodeset."""

    name: str  # NAMESPACE:NAME
    kind: str  # UAObject, UAVariable, UAObjectType, …
    type: str | None
    supertype: str | None
    rule: str | None
    data_type: str | None


class Nodesets:
    """Every node by NAMESPACE:NUMBER, with namespaces by the end of their address (`0` is the base)."""

    def __init__(self, names=("Di", "IA", "Machinery", "Robotics")) -> None:
        self.nodes: dict[str, Declared] = {}
        self.members: dict[str, list[str]] = defaultdict(list)
        self.enumerations: dict[str, dict[str, int]] = {}  # by name
        for name in names:
            self._read(ET.parse(files("monitor.gateway.opcua") / "nodesets" / f"Opc.Ua.{name}.NodeSet2.xml").getroot())

    def _read(self, root) -> None:
        spaces = ["0", *(each.text.removeprefix(FOUNDATION).rstrip("/") for each in root.find(f"{SCHEMA}NamespaceUris"))]
        aliases = {each.get("Alias"): each.text for each in root.iter(f"{SCHEMA}Alias")}

        def place(text):
            text = aliases.get(text, text)
            space, _, number = text.rpartition(";")
            return f"{spaces[int(space.removeprefix('ns=') or 0)]}:{number.removeprefix('i=')}"

        def named(text):
            space, sign, name = text.partition(":")
            return f"{spaces[int(space)]}:{name}" if sign else f"0:{text}"

        for node in root:
            if node.get("NodeId") is None or node.get("DesignToolOnly") == "true":
                continue
            own = place(node.get("NodeId"))
            fields = [each for each in node.iter(f"{SCHEMA}Field") if each.get("Value") is not None]
            self.enumerations[named(node.get("BrowseName"))] = {each.get("Name"): int(each.get("Value")) for each in fields}
            found = defaultdict(list)
            for each in node.iter(f"{SCHEMA}Reference"):
                found[place(each.get("ReferenceType")), each.get("IsForward") != "false"].append(place(each.text))
            first = {key: values[0] for key, values in found.items()}
            data = node.get("DataType")
            self.nodes[own] = Declared(
                *(named(node.get("BrowseName")), node.tag.removeprefix(SCHEMA), first.get(("0:40", True)), first.get(("0:45", False))),
                *(first.get(("0:37", True)), place(data) if data else None),
            )
            self.members[own] += [member for kind in ("0:47", "0:46") for member in found[kind, True]]
            for kind in ("0:47", "0:46"):
                for parent in found[kind, False]:
                    self.members[parent].append(own)

    def asked(self, type_or_declaration: str) -> list[tuple[str, Declared]]:
        """Members with a rule that makes them mandatory, of this node and of its supertypes; the nearest declaration of a name wins."""
        wanted, seen = [], set()
        at: str | None = type_or_declaration
        while at is not None and at in self.nodes:
            for member in dict.fromkeys(self.members[at]):
                about = self.nodes.get(member)
                if about is not None and about.rule and about.name not in seen:
                    seen.add(about.name)
                    if about.rule in {MANDATORY, MANDATORY_PLACEHOLDER}:
                        wanted.append((member, about))
            at = self.nodes[at].supertype
        return wanted

    def is_a(self, kind: str | None, wanted: str | None) -> bool:
        """Whether a type is another one, or below it."""
        while kind is not None and kind != wanted:
            kind = self.nodes[kind].supertype if kind in self.nodes else None
        return kind is not None


class Found(NamedTuple):
    """A node of a server, as a client has seen it."""

    name: str
    kind: str  # UAObject or UAVariable
    type: str | None
    data_type: str | None
    members: dict[str, "Found"]  # by name


def lacking(nodesets: Nodesets, found: Found, where: str = "", asked_by: str | None = None) -> list[str]:
    """What a node and everything below it lacks of what its type, and the declaration that it stands for, ask for."""
    wanted = {about.name: (member, about) for source in (found.type, asked_by) if source for member, about in nodesets.asked(source)}
    wrong, stands_for = [], {}
    for name, (member, about) in wanted.items():
        if about.rule == MANDATORY_PLACEHOLDER:
            fitting = [each for each in found.members.values() if nodesets.is_a(each.type, about.type)]
            stands_for |= {each.name: member for each in fitting}
            wrong += [] if fitting else [f"{where}: nothing stands for {name}"]
        elif name not in found.members:
            wrong.append(f"{where}: {name} is missing")
        else:
            own = found.members[name]
            stands_for[name] = member
            if own.kind != about.kind or not nodesets.is_a(own.type, about.type):
                wrong.append(f"{where}/{name}: is {own.kind} of {own.type}; expected {about.kind} of {about.type}")
            if about.data_type and own.data_type != about.data_type:
                wrong.append(f"{where}/{name}: data type {own.data_type}; expected {about.data_type}")
    for name, member in found.members.items():
        wrong += lacking(nodesets, member, f"{where}/{name}", stands_for.get(name))
    return wrong
