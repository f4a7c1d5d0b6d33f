"""A small certificate authority of a plant: one root that signs a certificate for each router, arm and person. Bytes in, bytes out.

New keys are elliptic (P-256); a certificate serves both ends of a connection, because a router listens and connects.
"""

import ipaddress
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from monitor.errors import BadInput

ROOT_YEARS = 20
EARLIER = timedelta(hours=1)  # a clock that is a little behind accepts a new certificate


class Issued(NamedTuple):
    """A certificate and its private key, as PEM."""

    certificate: bytes
    key: bytes


def new_root(name: str, now: datetime) -> Issued:
    """A root of a new authority, for 20 years."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _named(name)
    built = (
        _begun(subject, subject, key.public_key(), now, timedelta(days=365 * ROOT_YEARS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    return Issued(_pem(built), _key_pem(key))


class Authority:
    """Signs certificates. It is made of PEM, its own or that of a root of yours."""

    def __init__(self, root: Issued, where: str) -> None:
        """Raises BadInput where the two are no certificate of an authority with its private key. `where` names them in messages."""
        try:
            self._certificate = x509.load_pem_x509_certificate(root.certificate)
            key = serialization.load_pem_private_key(root.key, password=None)
        except (ValueError, TypeError) as error:
            raise BadInput(f"{where}: no certificate with an unencrypted private key (PEM): {error}") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey):
            raise BadInput(f"{where}: expected an elliptic or an RSA key, found another kind")
        self._key = key
        try:
            basic = self._certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
        except x509.ExtensionNotFound:
            basic = x509.BasicConstraints(ca=False, path_length=None)
        if not basic.ca:
            raise BadInput(f"{where}: the certificate is that of no authority (basicConstraints says CA:FALSE)")
        if self._certificate.public_key() != key.public_key():
            raise BadInput(f"{where}: the private key is not that of the certificate")
        self.pem = root.certificate

    def issue(self, name: str, addresses: Sequence[str], now: datetime, days: int) -> Issued:
        """A certificate for one name, whose bearer may be reached at the addresses. Raises BadInput where it would outlive the root."""
        if now + timedelta(days=days) > self._certificate.not_valid_after_utc:
            until = self._certificate.not_valid_after_utc.date().isoformat()
            raise BadInput(
                f"a certificate of {days} days would outlive its authority, which ends on {until}; give fewer days or another root"
            )
        key = ec.generate_private_key(ec.SECP256R1())
        public = key.public_key()
        builder = _begun(_named(name), self._certificate.subject, public, now, timedelta(days=days))
        if addresses:
            builder = builder.add_extension(x509.SubjectAlternativeName([_alternative(each) for each in addresses]), critical=False)
        built = (
            builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
            .sign(self._key, hashes.SHA256())
        )
        return Issued(_pem(built), _key_pem(key))


class Described(NamedTuple):
    """What a certificate says of itself."""

    name: str  # its common name
    until: datetime
    addresses: tuple[str, ...]


def describe(certificate: bytes, where: str, *, root: bytes | None = None) -> Described:
    """What a certificate says. Raises BadInput where it is none, or is not signed by `root`."""
    try:
        read = x509.load_pem_x509_certificate(certificate)
    except ValueError as error:
        raise BadInput(f"{where}: is no certificate (PEM): {error}") from None
    if root is not None:
        try:
            read.verify_directly_issued_by(x509.load_pem_x509_certificate(root))
        except (ValueError, TypeError, InvalidSignature):
            raise BadInput(f"{where}: is not signed by the authority of this folder") from None
    try:
        alternatives = tuple(str(each.value) for each in read.extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    except x509.ExtensionNotFound:
        alternatives = ()
    names = read.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return Described(str(names[0].value) if names else "", read.not_valid_after_utc, alternatives)


def belongs(issued: Issued) -> bool:
    """Whether the key is that of the certificate. Raises BadInput where one of them cannot be read."""
    try:
        key = serialization.load_pem_private_key(issued.key, password=None)
        return x509.load_pem_x509_certificate(issued.certificate).public_key() == key.public_key()
    except (ValueError, TypeError) as error:
        raise BadInput(f"no certificate with an unencrypted private key (PEM): {error}") from None


def _begun(
    subject: x509.Name, issuer: x509.Name, public: ec.EllipticCurvePublicKey, now: datetime, valid: timedelta
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLIER)
        .not_valid_after(now + valid)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
    )


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _alternative(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
