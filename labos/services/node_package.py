"""Packs everything that a node needs on the computer of its instrument into one archive.

The archive holds a script that installs the node, its systemd unit, its settings and, for a secure bus, its
certificate.
"""

from __future__ import annotations

import gzip
import io
import re
import shlex
import tarfile
from collections.abc import Mapping
from pathlib import Path

import msgspec

from labos.errors import BadInput

ENDPOINT = re.compile(r"(?:tcp|tls)/[A-Za-z0-9.\-:\[\]]+:\d{1,5}")
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*")

UNITS = ("labos-node@.service", "labos.sysusers.conf")
"""Files of ``deploy/systemd`` that are added."""


def read_units() -> dict[str, str]:
    """The text of each of UNITS: from the wheel, else from the checkout."""
    package = Path(__file__).resolve().parents[1]
    packaged = package / "_deploy"
    folder = packaged if packaged.is_dir() else package.parent / "deploy" / "systemd"
    return {name: (folder / name).read_text() for name in UNITS}


class NodePackage(msgspec.Struct, frozen=True):
    """A node that will be installed. ``certificate`` is the folder of its certificate, if the bus is secure.
    ``options`` are arguments of ``labos node start``. pip installs ``requirement``, from ``wheels`` if there
    are any."""

    workcell: str
    name: str
    connect: str
    requirement: str
    options: str = ""
    certificate: Path | None = None
    wheels: tuple[Path, ...] = ()

    @property
    def module(self) -> str:
        return f"{self.workcell}/{self.name}"


def pack_node(package: NodePackage) -> bytes:
    """The archive (tar, gzip). The same files give the same bytes. Raises BadInput for a name or an address
    that a systemd unit cannot contain."""
    _check(package)
    place = f"/etc/labos/certificates/{package.workcell}.{package.name}"
    options = f"--connect {package.connect}"
    if package.certificate is not None:
        options += f" --secure --cert {place}"
    options += f" {package.options}" if package.options else ""
    files = {
        "install.sh": _write_script(package, place).encode(),
        f"node-{package.name}.env": f"LABOS_WORKCELL={package.workcell}\nLABOS_NODE={options}\n".encode(),
        "labos.env": b"LABOS_HOME=/var/lib/labos/lab\n",
        **{name: text.encode() for name, text in read_units().items()},
        **{f"wheels/{path.name}": path.read_bytes() for path in package.wheels},
    }
    if package.certificate is not None:
        names = ("ca.pem", "cert.pem", "key.pem")
        files |= {f"certificate/{name}": _read(package.certificate / name) for name in names}
    return _pack_tar(f"labos-node-{package.workcell}-{package.name}", files)


def _check(package: NodePackage) -> None:
    for text in (package.workcell, package.name):
        if not NAME.fullmatch(text):
            raise BadInput(
                f"{text!r} cannot be part of the name of a systemd unit.",
                remedy="Name WORKCELL/MODULE, of letters, digits, dots, hyphens and underscores.",
            )
    if not ENDPOINT.fullmatch(package.connect):
        raise BadInput(
            f"{package.connect!r} is not an address of a bus.",
            remedy="Give it as tcp/HOST:7447, or tls/HOST:7447 for a secure bus.",
        )
    secure = package.connect.startswith("tls/")
    if secure != (package.certificate is not None):
        raise BadInput(
            "A secure bus (tls/) and a certificate have to be used together.",
            remedy=f"Make one: labos pki issue node {package.module}"
            if secure
            else "Give the address as tls/HOST:7447.",
        )
    if "\n" in package.options or "\0" in package.options:
        raise BadInput("The options hold a line break.", remedy="Write them on one line.")


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(
            f"{path} cannot be read: {error.strerror or error}.",
            remedy="Name the folder with ca.pem, cert.pem and key.pem (--cert).",
        ) from None


def _write_script(package: NodePackage, place: str) -> str:
    wheels = '--find-links "$HERE/wheels"' if package.wheels else ""
    certificate = ""
    if package.certificate is not None:
        certificate = f"""
say "certificate"
install -d -m 0750 "$ROOT/etc/labos/certificates" "$ROOT{place}"
for file in ca.pem cert.pem key.pem; do
  install -m 0600 "$HERE/certificate/$file" "$ROOT{place}/$file"
done
own labos:labos "$ROOT{place}" "$ROOT{place}"/*.pem
own root:labos "$ROOT/etc/labos/certificates"
"""
    return f"""#!/bin/sh
# Installs the node of {package.module} on this computer, or brings it up to date. Run it as root:
#
#     sh install.sh
#
# It may be run again. ROOT=/some/folder installs below that folder, and starts nothing; LABOS_KEEP_PROGRAM=1
# leaves the program as it is.
set -eu
HERE=$(cd "$(dirname "$0")" && pwd)
ROOT=${{ROOT:-}}
say() {{ echo "labos-node-{package.name}: $*"; }}
own() {{ [ -n "$ROOT" ] || chown "$@"; }}

if [ -z "$ROOT" ] && [ "$(id -u)" != 0 ]; then
  echo "install.sh: run it as root (sudo sh install.sh)" >&2
  exit 1
fi

say "program"
if [ ! -x "$ROOT/opt/labos/bin/python" ]; then
  python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {{
    echo "install.sh: this needs Python 3.11 or later; python3 is $(python3 --version 2>&1)" >&2
    exit 1
  }}
  python3 -m venv "$ROOT/opt/labos"
fi
if [ -z "${{LABOS_KEEP_PROGRAM:-}}" ]; then
  "$ROOT/opt/labos/bin/pip" install --quiet {shlex.quote(package.requirement)} {wheels}
fi

say "user"
install -D -m 0644 "$HERE/labos.sysusers.conf" "$ROOT/usr/lib/sysusers.d/labos.conf"
[ -n "$ROOT" ] || systemd-sysusers

say "settings"
install -d -m 0755 "$ROOT/etc/labos"
[ -e "$ROOT/etc/labos/labos.env" ] || install -m 0640 "$HERE/labos.env" "$ROOT/etc/labos/labos.env"
install -m 0640 "$HERE/node-{package.name}.env" "$ROOT/etc/labos/node-{package.name}.env"
own root:labos "$ROOT/etc/labos/labos.env" "$ROOT/etc/labos/node-{package.name}.env"
{certificate}
say "unit"
install -D -m 0644 "$HERE/labos-node@.service" "$ROOT/etc/systemd/system/labos-node@.service"
if [ -z "$ROOT" ]; then
  systemctl daemon-reload
  systemctl enable labos-node@{package.name}
  systemctl restart labos-node@{package.name} # one that is at work finishes its action first
  say "runs: systemctl status labos-node@{package.name}"
fi
"""


def _pack_tar(folder: str, files: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, data in sorted(files.items()):
            entry = tarfile.TarInfo(f"{folder}/{name}")
            entry.size = len(data)
            entry.mode = 0o600 if name.startswith("certificate/") else 0o644
            archive.addfile(entry, io.BytesIO(data))
    return gzip.compress(buffer.getvalue(), mtime=0)
