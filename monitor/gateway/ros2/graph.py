"""What rmw_zenoh makes of a topic: the key of its messages, what travels beside each, and the tokens by which nodes see each other.

The format is that of ros2/rmw_zenoh, docs/design.md ("Topic and Service name mapping to Zenoh key expressions", "Graph Cache"), and of
its sources where that page is silent: rmw_zenoh_cpp/src/detail/liveliness_utils.cpp (`qos_to_keyexpr`) and attachment_helpers.cpp.
"""

import hashlib
from dataclasses import dataclass

from zenoh.ext import Int64, z_serialize

NODE, PUBLISHER = "NN", "MP"  # kinds of entities
NO_HASH = "TypeHashNotSupported"  # in the place of a hash, where the ROS 2 distribution has none
DEPTH = 10  # messages that are kept for a slow subscriber, as diagnostic_updater keeps
GID_BYTES = 16
NODE_ID, PUBLISHER_ID = 0, 1  # within the session


def mangled(name: str) -> str:
    """A name as one chunk of a key: an empty one is `%`."""
    return name.replace("/", "%") or "%"


def type_name(name: str) -> str:
    """A message's type as DDS declares it: `diagnostic_msgs/msg/DiagnosticArray` → `diagnostic_msgs::msg::dds_::DiagnosticArray_`."""
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


@dataclass(frozen=True, slots=True, kw_only=True)
class Publication:
    """One topic of one node in one session."""

    domain: int  # ROS_DOMAIN_ID
    session_id: str  # of Zenoh
    node: str
    topic: str  # the whole name, with its slash
    message: str  # e.g. diagnostic_msgs/msg/DiagnosticArray
    type_hash: str  # RIHS01_…, or NO_HASH

    @property
    def key(self) -> str:
        """Where its messages are published: `<domain_id>/<fully_qualified_name>/<type_name>/<type_hash>`."""
        return f"{self.domain}/{self.topic.strip('/')}/{type_name(self.message)}/{self.type_hash}"

    @property
    def node_token(self) -> str:
        """The liveliness token of its node."""
        return self._token(NODE_ID, NODE)

    @property
    def token(self) -> str:
        """The liveliness token of the publisher: what `ros2 topic list` and `info` show of it."""
        # reliable, volatile and keep-last are defaults, which are left out; depth is not the default of 42
        qos = f"::,{DEPTH}:,:,:,,"
        topic = f"{mangled(self.topic)}/{mangled(type_name(self.message))}/{mangled(self.type_hash)}"
        return f"{self._token(PUBLISHER_ID, PUBLISHER)}/{topic}/{qos}"

    @property
    def gid(self) -> bytes:
        """Sixteen bytes that tell this publisher from every other: a digest of its token. rmw_zenoh takes another digest of the same."""
        return hashlib.blake2b(self.token.encode(), digest_size=GID_BYTES).digest()

    def _token(self, entity: int, kind: str) -> str:
        root = mangled("/")  # of enclave and namespace
        return f"@ros2_lv/{self.domain}/{self.session_id}/{NODE_ID}/{entity}/{kind}/{root}/{root}/{self.node}"

    def attachment(self, sequence: int, at_ns: int) -> bytes:
        """What travels beside a message: its number from 1, the time when it was sent [ns since 1970], and who sent it."""
        return bytes(z_serialize((Int64(sequence), Int64(at_ns), self.gid)))
