"""Certificates for tests, created in a folder: an authority, a server, a client; useless elsewhere."""

from __future__ import annotations

import ipaddress
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

NOW = datetime.now(UTC)
DAY = timedelta(days=1)


class Authority:
    """A certificate authority; its certificate is the file `ca`."""

    def __init__(self, folder: Path, name: str = "plant") -> None:
        self.folder = folder
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        builder = self._builder(self._name, self._key.public_key(), NOW + DAY)
        builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        self.ca = folder / f"{name}-ca.pem"
        self.ca.write_bytes(self._signed(builder))

    def _builder(self, name: x509.Name, key: ec.EllipticCurvePublicKey, until: datetime) -> x509.CertificateBuilder:
        return x509.CertificateBuilder(
            issuer_name=self._name, subject_name=name, public_key=key, serial_number=x509.random_serial_number(),
            not_valid_before=NOW - 2 * DAY, not_valid_after=until,
        )  # fmt: skip

    def _signed(self, builder: x509.CertificateBuilder) -> bytes:
        return builder.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)

    def issue(
        self, name: str, *, hosts: tuple[str, ...] = (), until: datetime = NOW + DAY, password: bytes | None = None
    ) -> tuple[Path, Path]:
        """Write a certificate for these hosts and addresses, and its key; return both files."""
        key = ec.generate_private_key(ec.SECP256R1())
        builder = self._builder(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]), key.public_key(), until)
        if hosts:
            names: list[x509.GeneralName] = []
            for host in hosts:
                is_address = host[0].isdigit()
                names.append(x509.IPAddress(ipaddress.ip_address(host)) if is_address else x509.DNSName(host))
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        cert, secret = self.folder / f"{name}.pem", self.folder / f"{name}.key"
        cert.write_bytes(self._signed(builder))
        locked = serialization.NoEncryption() if password is None else serialization.BestAvailableEncryption(password)
        secret.write_bytes(key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, locked))
        return cert, secret
