"""``labos node install``: a node for the computer of its instrument."""

from __future__ import annotations

from pathlib import Path

import click

from labos.cli._complete import make_completer
from labos.cli._options import cert_option, file_option, folder_home_option, json_option, pki_option
from labos.cli._out import report_done, write_new
from labos.errors import BadInput
from labos.settings import Settings, last_kernel
from labos.version import VERSION


@click.command("install")
@click.argument("module", shell_complete=make_completer("module"), metavar="WORKCELL/MODULE")
@click.option(
    "--connect",
    required=True,
    metavar="ENDPOINT",
    help="The lab's bus as that computer reaches it: tcp/HOST:7447, or tls/HOST:7447 if it is secure.",
)
@file_option("-o", "--output", "file", help="The file to write (labos-node-WORKCELL-MODULE.tar.gz).")
@click.option(
    "--option",
    "options",
    default="",
    metavar="TEXT",
    help="Further options of `labos node start`, such as --option '--metrics-port 9101'.",
)
@click.option(
    "--wheel",
    "wheels",
    multiple=True,
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    metavar="FILE",
    help="A wheel to install LabOS from, for a computer that reaches no package index.",
)
@cert_option
@pki_option
@folder_home_option
@json_option
def install(
    module: str,
    connect: str,
    file: Path | None,
    options: str,
    wheels: tuple[Path, ...],
    cert: Path | None,
    pki: Path | None,
    home: str | None,
) -> None:
    """Write an archive that installs the node of WORKCELL/MODULE on another computer with Linux and systemd:
    program, user, settings, certificate and systemd unit.

    For a secure bus the archive contains the node's private key. A certificate is issued if there is none.
    Copy the archive over a confidential connection, unpack it there, and run its install.sh as root. Repeat
    this after an upgrade of the lab.

    \b
    labos node install rpl/sealer --connect tls/lab.example.org:7447
    scp labos-node-rpl-sealer.tar.gz sealer-pc:
    ssh sealer-pc 'tar xzf labos-node-rpl-sealer.tar.gz && sudo sh labos-node-rpl-sealer/install.sh'
    """
    from labos.services.node_package import NodePackage, pack_node

    workcell, slash, name = module.partition("/")
    if not slash or not name:
        raise BadInput(f"{module!r} has no workcell.", remedy="Name WORKCELL/MODULE, such as rpl/sealer.")
    settings = Settings.make(home, authority=pki)
    folder = cert.absolute() if cert is not None else _certificate(settings, module, connect)
    requirement = f"labos-sdl[drivers]=={VERSION}"
    data = pack_node(NodePackage(workcell, name, connect, requirement, options, folder, wheels))
    target = file or Path(f"labos-node-{workcell}-{name}.tar.gz")
    write_new(target, data)
    secret = " It holds the node's private key." if folder is not None else ""
    facts = {"module": module, "file": str(target), "secure": folder is not None, "version": VERSION}
    report_done(f"{target} installs the node of {module} (LabOS {VERSION}).{secret}", facts)


def _certificate(settings: Settings, module: str, connect: str) -> Path | None:
    """The folder of the node's own certificate, which is issued if there is none; None if the bus is not
    secure."""
    from labos.pki import Authority, PartyIdentity

    if not connect.startswith("tls/"):
        return None
    authority, known = Authority(settings.pki), last_kernel(settings.home)
    if not authority.issues or known is None:
        raise BadInput(
            f"{settings.pki} has no certificate authority to issue a certificate for {module}.",
            remedy="Name the node's certificate: --cert FOLDER; or the lab's folder: --home DIR.",
        )
    return authority.ensure(PartyIdentity("node", module, known.lab)).folder
