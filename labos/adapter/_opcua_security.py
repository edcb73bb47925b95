"""Access to an OPC UA server: its encryption and user. Secrets (the key, the password) are given by the paths
of their files, the password also by an environment variable, because the workcell file is stored permanently.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec

from labos.errors import DeviceError
from labos.node.secrets import read_secret

POLICIES = ("Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss")
MODES = {"sign_and_encrypt": "SignAndEncrypt", "sign": "Sign"}
FILES = ("opcua_certificate", "opcua_key", "opcua_server_certificate")


class OpcuaAccess(msgspec.Struct, frozen=True):
    """``uri`` is the application's URI in its certificate. If ``policy`` is empty, there is no encryption."""

    policy: str = ""
    mode: str = ""
    certificate: str = ""
    key: str = ""
    server_certificate: str = ""
    uri: str = ""
    user: str = ""
    password: str = ""

    async def prepare(self, client: Any) -> None:
        """Configure a client of asyncua before it connects. Raises the errors of asyncua."""
        if self.policy:
            from asyncua import ua
            from asyncua.crypto import security_policies

            client.application_uri = self.uri
            await client.set_security(
                getattr(security_policies, f"SecurityPolicy{self.policy}"),
                self.certificate,
                self.key,
                server_certificate=self.server_certificate,
                mode=getattr(ua.MessageSecurityMode, self.mode),
            )
        if self.user:
            client.set_user(self.user)
            client.set_password(self.password)


def access_of(config: dict[str, Any]) -> OpcuaAccess:
    """The access from ``config:`` of a module. Raises DeviceError (``none``) naming the key."""
    url = str(config.get("opcua_url") or "")
    if "@" in urlsplit(url).netloc:
        raise _make_error(
            "`opcua_url` contains a user, and the workcell file is stored permanently.",
            "Write `opcua_user`, and the path of a file with the password as `opcua_password`.",
        )
    policy, user = str(config.get("opcua_policy") or ""), str(config.get("opcua_user") or "")
    password = read_secret(config, "opcua_password", file_key="opcua_password")
    if user and not policy and not config.get("opcua_insecure"):
        raise _make_error(
            "`opcua_user` without `opcua_policy`: the password would be sent over the network unencrypted.",
            "Write `opcua_policy`, or `opcua_insecure: true` where nobody else can listen.",
        )
    if not policy:
        if given := [key for key in (*FILES, "opcua_mode") if config.get(key)]:
            raise _make_error(
                f"`{given[0]}` has no effect without `opcua_policy`.", f"It is {_one_of(POLICIES)}."
            )
        return OpcuaAccess(user=user, password=password)
    if policy not in POLICIES:
        raise _make_error(f"`opcua_policy` is {policy!r}.", f"It is {_one_of(POLICIES)}.")
    mode = str(config.get("opcua_mode") or "sign_and_encrypt")
    if mode not in MODES:
        raise _make_error(f"`opcua_mode` is {mode!r}.", f"It is {_one_of(tuple(MODES))}.")
    own, key, server = (_find_file(config, name) for name in FILES)
    return OpcuaAccess(policy, MODES[mode], own, key, server, _read_uri(own), user, password)


def _find_file(config: dict[str, Any], key: str) -> str:
    path = str(config.get(key) or "")
    if not path:
        raise _make_error(f"`opcua_policy` needs `{key}`.", "Write the path of a PEM or DER file.")
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise _make_error(
            f"`{key}` names the file {path!r}, which cannot be read ({error.strerror})."
        ) from error
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization

    pem = data.lstrip().startswith(b"-----")
    try:
        if key == "opcua_key":
            read = serialization.load_pem_private_key if pem else serialization.load_der_private_key
            read(data, None)
        else:
            (x509.load_pem_x509_certificate if pem else x509.load_der_x509_certificate)(data)
    except (ValueError, TypeError) as error:
        what = "key without a passphrase" if key == "opcua_key" else "certificate"
        raise _make_error(f"`{key}` names the file {path!r}, which holds no {what} ({error}).") from error
    if pem != path.endswith(".pem"):  # asyncua decides by the name
        raise _make_error(f"`{key}` names the file {path!r}.", f"Call it .{'pem' if pem else 'der'}.")
    return path


def _read_uri(path: str) -> str:
    """The application's URI in a certificate, which a server compares with the client's."""
    from cryptography import x509

    data = Path(path).read_bytes()
    pem = data.lstrip().startswith(b"-----")
    certificate = (x509.load_pem_x509_certificate if pem else x509.load_der_x509_certificate)(data)
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        return str(names.get_values_for_type(x509.UniformResourceIdentifier)[0])
    except (x509.ExtensionNotFound, IndexError) as error:
        raise _make_error(
            f"The certificate {path} names no application URI.",
            "Make one with a URI as subjectAltName, as OPC UA requires.",
        ) from error


def _one_of(words: tuple[str, ...]) -> str:
    return " or ".join([", ".join(words[:-1]), words[-1]])


def _make_error(message: str, remedy: str = "") -> DeviceError:
    return DeviceError(message, effects="none", remedy=remedy)
