# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Certificates of OPC UA applications: one folder, nothing trusted unless somebody put it there.

| in the folder | what |
|---|---|
| `own/cert.der`, `own/key.pem` | made at the first start; give cert.der to the other side |
| `trusted/*.der` | certificates of the other sides that are trusted, one by one |
| `rejected/*.der` | certificates that came and were not trusted: move one to trusted/ to trust it |
"""

import hashlib
import os
import socket
from datetime import UTC, datetime
from pathlib import Path

from asyncua.crypto.cert_gen import generate_private_key, generate_self_signed_app_certificate
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID

_DAYS = 3650


class Pki:
    """A folder of certificates.

    Args:
        folder: made if it does not exist.
        uri: application URI that the own certificate is for.
    """

    def __init__(self, folder: Path, uri: str) -> None:
        self.folder, self.uri = folder, uri
        self.certificate, self.key = folder / "own" / "cert.der", folder / "own" / "key.pem"
        for name in ("own", "trusted", "rejected"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        if not (self.certificate.is_file() and self.key.is_file()):
            self._make()

    def trusts(self, der: bytes) -> bool:
        """Whether a certificate was put into trusted/ and is valid today; if not, it is kept in rejected/."""
        known = any(path.read_bytes() == der for path in (self.folder / "trusted").glob("*.der"))
        if known and self._in_time(der):
            return True
        name = hashlib.sha256(der).hexdigest()[:16]
        (self.folder / "rejected" / f"{name}.der").write_bytes(der)
        return False

    def trust(self, certificate: Path) -> None:
        """Puts a certificate into trusted/."""
        der = certificate.read_bytes()
        (self.folder / "trusted" / f"{hashlib.sha256(der).hexdigest()[:16]}.der").write_bytes(der)

    @staticmethod
    def _in_time(der: bytes) -> bool:
        try:
            certificate = x509.load_der_x509_certificate(der)
        except ValueError:
            return False
        return certificate.not_valid_before_utc <= datetime.now(tz=UTC) <= certificate.not_valid_after_utc

    def _make(self) -> None:
        key = generate_private_key()
        host = socket.gethostname()
        names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(self.uri), x509.DNSName(host)]
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
        subject = {"organizationName": "ros2_deepc", "commonName": f"gateway on {host}"[:64]}
        made = generate_self_signed_app_certificate(key, self.uri, subject, names, extended=usages, days=_DAYS)
        pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        with open(os.open(self.key, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
            file.write(pem)
        self.certificate.write_bytes(made.public_bytes(Encoding.DER))
