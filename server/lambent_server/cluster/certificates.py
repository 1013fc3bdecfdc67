"""Certificates of the address for run processes: given ones, or those of an authority that the servers share.

The servers make the authority once and keep it beside the secret for run processes. Every server issues
itself a certificate when it starts, whose key never leaves the process. Runs get the authority with their
launch. Given ones are replaced sooner or later: their files are read again when they have changed.
"""

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from lambent_server.cluster.shared_secrets import shared_secret
from lambent_server.core.settings import ServeError, Settings
from lambent_server.database.engine import Database

log = structlog.get_logger()

NAME = "worker.authority"
SERVER_NAME = "server.lambent.internal"
"""The name in certificates of our own: runs reach servers by many names, and trust the authority for all."""
_VALID = datetime.timedelta(days=3650)
_CLOCKS_DIFFER = datetime.timedelta(days=1)


@dataclass(frozen=True, kw_only=True, slots=True)
class Certificate:
    """What a server shows, and by what runs recognise it."""

    chain: bytes
    key: bytes
    authority: str
    """Certificates (PEM); empty for those that gRPC brings."""
    name: str
    """The name in the certificate; empty if it is the server's address."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ServerAddress:
    """Where run processes reach this server, and by what they know it and the others."""

    address: str
    """Where this server is for its own runs."""
    authority: str = ""
    """Certificates (PEM) by which they check servers on other machines."""
    authority_name: str = ""
    """The name in the servers' certificates, if it is not their address."""


def certificate_for(database: Database, settings: Settings) -> Certificate:
    """Return the certificate of the settings, or a new one of the servers' own authority.

    Raises ServeError if one of the settings' files is missing or is not what it should be.
    """
    if settings.worker_certificate is None:
        return issue(shared_secret(database, settings, NAME, make_authority))
    return _given(settings)


def _given(settings: Settings) -> Certificate:
    """Return the certificate in the files of the settings; raises ServeError for files that are none."""
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    certificate, key, authority = settings.worker_certificate, settings.worker_key, settings.worker_authority
    if certificate is None or key is None:
        raise ServeError("serve.worker_key_missing: LAMBENT_WORKER_CERTIFICATE needs LAMBENT_WORKER_KEY too")
    given = Certificate(
        chain=_checked(certificate, x509.load_pem_x509_certificates),
        key=_checked(key, lambda data: load_pem_private_key(data, None)),
        authority="" if authority is None else _checked(authority, x509.load_pem_x509_certificates).decode(),
        name="",
    )
    own = x509.load_pem_x509_certificates(given.chain)[0].public_key()
    if own != load_pem_private_key(given.key, None).public_key():
        raise ServeError(
            f"serve.worker_certificate_invalid: {key} is not the key of the first certificate in "
            f"{certificate}; give both files of the same certificate"
        )
    return given


class Renewals:
    """Notices a new certificate in the files of the settings."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._seen = self._versions()

    def __call__(self) -> Certificate | None:
        """Return the new certificate, once; None if there is none.

        Files that cannot be used are logged, once, and the certificate before them stays in use; so it is
        while only one of the two has been replaced.
        """
        versions = self._versions()
        if versions == self._seen:
            return None
        self._seen = versions
        try:
            certificate = _given(self._settings)
        except ServeError as error:
            log.warning("worker_certificate_not_renewed", reason=str(error))
            return None
        log.info("worker_certificate_renewed", path=str(self._settings.worker_certificate))
        return certificate

    def _versions(self) -> list[tuple[int, int, int] | None]:
        return [_version(path) for path in (self._settings.worker_certificate, self._settings.worker_key)]


def _version(path: Path | None) -> tuple[int, int, int] | None:
    """Return what changes with the content of a file; None if it is not there."""
    try:
        status = None if path is None else path.stat()
    except OSError:
        return None
    return None if status is None else (status.st_ino, status.st_size, status.st_mtime_ns)


def _checked(path: Path, load: Callable[[bytes], object]) -> bytes:
    """Return a file that `load` can read."""
    try:
        data = path.read_bytes()
        load(data)
    except (OSError, ValueError, TypeError) as error:
        raise ServeError(
            f"serve.worker_certificate_invalid: {path} cannot be used ({error}); give a PEM file without "
            "a passphrase that this user can read"
        ) from error
    return data


def make_authority() -> str:
    """Return a new authority: its certificate and private key (PEM)."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "Lambent servers")])
    at = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(at - _CLOCKS_DIFFER)
        .not_valid_after(at + _VALID)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return _pem(certificate) + _pem_of_key(key)


def issue(authority: str) -> Certificate:
    """Return a new certificate of a server, signed by an authority of `make_authority`."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    issuer = x509.load_pem_x509_certificate(authority.encode())
    issuer_key = serialization.load_pem_private_key(authority.encode(), None)
    assert isinstance(issuer_key, ec.EllipticCurvePrivateKey)
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, SERVER_NAME)]))
        .issuer_name(issuer.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.datetime.now(datetime.UTC) - _CLOCKS_DIFFER)
        .not_valid_after(issuer.not_valid_after_utc)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(SERVER_NAME)]), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()), critical=False
        )
        .sign(issuer_key, hashes.SHA256())
    )
    return Certificate(
        chain=_pem(certificate).encode(),
        key=_pem_of_key(key).encode(),
        authority=_pem(issuer),
        name=SERVER_NAME,
    )


def _usage(*, signs: bool) -> Any:
    from cryptography.x509 import KeyUsage

    return KeyUsage(
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


def _pem(certificate: Any) -> str:
    from cryptography.hazmat.primitives.serialization import Encoding

    return str(certificate.public_bytes(Encoding.PEM).decode("ascii"))


def _pem_of_key(key: Any) -> str:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return str(pem.decode("ascii"))
