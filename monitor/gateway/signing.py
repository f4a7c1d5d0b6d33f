"""Signatures of webhooks, by the open specification Standard Webhooks (standardwebhooks.com): symmetric, HMAC-SHA256. No I/O, no clock.

What is signed is `ID.TIMESTAMP.BODY`; the header webhook-signature holds `v1,` and the signature in base64, and may hold several of them.
"""

import base64
import binascii
import hashlib
import hmac
from collections.abc import Mapping

from monitor.errors import BadInput

ID, TIMESTAMP, SIGNATURE = "webhook-id", "webhook-timestamp", "webhook-signature"
PREFIX = "whsec_"  # of a secret in base64
TOLERANCE_S = 300.0  # between the sender's clock and ours


def key_of(secret: str) -> bytes:
    """The key of a secret: whsec_ and base64, or any other text as it is. Raises BadInput."""
    if not secret.startswith(PREFIX):
        return secret.encode()
    try:
        return base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    except binascii.Error:
        raise BadInput("a webhook's secret begins with whsec_, and goes on with what is no base64") from None


def signed(secret: str, name: str, at_unix_s: float, body: bytes) -> dict[str, str]:
    """The headers of a message. name : the same one where it is sent again."""
    at = str(int(at_unix_s))
    return {ID: name, TIMESTAMP: at, SIGNATURE: f"v1,{_signature(secret, name, at, body)}"}


def verified(secret: str, headers: Mapping[str, str], body: bytes, now_unix_s: float) -> str:
    """The name of a message that somebody with this secret has signed lately. Raises BadInput that says why it is none."""
    try:
        name, at, signatures = (headers[each] for each in (ID, TIMESTAMP, SIGNATURE))
    except KeyError as error:
        raise BadInput(f"the header {error.args[0]} is missing") from None
    if not (at.isascii() and at.isdigit() and len(at) < 13):
        raise BadInput(f"the header {TIMESTAMP} is no time; expected seconds since 1970")
    if abs(now_unix_s - int(at)) > TOLERANCE_S:
        raise BadInput(f"it was signed more than {TOLERANCE_S:g} s ago, or one of the clocks is wrong")
    expected = _signature(secret, name, at, body)
    given = [each.partition(",")[2] for each in signatures.split() if each.startswith("v1,")]
    if not any(hmac.compare_digest(expected.encode(), each.encode()) for each in given):
        raise BadInput("its signature is not that of our secret")
    return name


def _signature(secret: str, name: str, at: str, body: bytes) -> str:
    return base64.b64encode(hmac.new(key_of(secret), f"{name}.{at}.".encode() + body, hashlib.sha256).digest()).decode()
