"""``labos pki``: certificates for a secure bus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import msgspec

from labos.cli._group import Suggesting
from labos.cli._options import pki_option, why_option
from labos.cli._out import end_with_json, report_done
from labos.cli._query import Where, find_lab_id, folder_and_json, now_ns
from labos.errors import NotFound
from labos.pki import KINDS, PROCESS_NAME, Authority, CertificateEntry, PartyIdentity
from labos.services.times import show_time
from labos.settings import Settings

kind_argument = click.argument("kind", type=click.Choice(KINDS))
name_argument = click.argument("name", required=False, default="")
lab_option = click.option(
    "--lab-id", "lab", metavar="ID", help="The lab's id (that of the log in the lab's folder)."
)
address_option = click.option(
    "--address", multiple=True, metavar="HOST", help="A name or address at which a kernel or bus is reached."
)
days_option = click.option(
    "--days", type=click.IntRange(1, 36500), metavar="N", help="Validity in days (authority: 3650, else 365)."
)


@click.group("pki", cls=Suggesting, short_help="Issue certificates for a secure bus.")
def command() -> None:
    """Manage a small certificate authority for the lab's bus, or certificates that the site issued. The
    authority is in the lab's folder (pki/).

    `labos up --secure` creates the authority, and certificates for the kernel and its nodes. Use these
    commands for nodes on other computers, for programs that only listen, and after the loss of a key. A
    running lab or bus applies a change within two seconds. docs/secure-bus.md describes the procedure.

    \b
    labos pki init                          create the authority
    labos pki issue node rpl/sealer         a certificate for a module's node
    labos pki issue viewer dashboard        for a program that only listens
    labos pki list                          all certificates, and when they expire
    labos pki renew rpl/sealer              a new key and certificate under the same name
    labos pki revoke rpl/sealer --why TEXT  refuse its certificate from now on
    """


@command.command("init")
@click.option(
    "--ca",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Use the site's certificate authority: a PEM file with its certificate, or several.",
)
@days_option
@pki_option
@folder_and_json
def init(where: Where, ca: Path | None, days: int | None, pki: Path | None) -> None:
    """Create the authority. This is done once. With its private key (ca.key) a person can act as any kernel
    or node, so keep it secret. You can store it offline. It is needed only to issue, renew and revoke."""
    from socket import gethostname

    authority = _find_authority(where, pki)
    more = {"days": days} if days else {}
    authority.init(f"LabOS authority of {gethostname()}"[:64], site=ca, **more)
    facts = {"folder": str(authority.folder), "issues": authority.issues}
    who = "LabOS issues the certificates" if authority.issues else "the site issues the certificates"
    report_done(f"{authority.folder}: {who}.", facts)


@command.command("issue")
@kind_argument
@name_argument
@address_option
@days_option
@lab_option
@pki_option
@folder_and_json
def issue(
    where: Where,
    kind: Any,
    name: str,
    address: tuple[str, ...],
    days: int | None,
    lab: str | None,
    pki: Path | None,
) -> None:
    """Issue a certificate and its key, and print their folder. Copy this folder to the computer that uses
    the certificate, over a confidential connection (scp), with the same file permissions.

    KIND is node (NAME is WORKCELL/MODULE), kernel, bus, api (NAME is the name of an API process), viewer
    (NAME is free), or stop. A certificate of kind stop may only stop modules in an emergency (`labos
    estop --connect ENDPOINT`).

    \b
    labos pki issue node rpl/sealer
    labos pki issue bus --address bus.example.org
    """
    authority = _find_authority(where, pki)
    identity = _make_identity(where, kind, name, lab)
    more = {"days": days} if days else {}
    entry = authority.issue(identity, addresses=address, **more)
    _report_folder(authority, entry)


@command.command("admit")
@kind_argument
@name_argument
@click.option(
    "--certificate",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The certificate, a PEM file.",
)
@click.option(
    "--key",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The private key of the certificate, a PEM file.",
)
@lab_option
@pki_option
@folder_and_json
def admit(
    where: Where, kind: Any, name: str, certificate: Path, key: Path, lab: str | None, pki: Path | None
) -> None:
    """Accept a certificate that the site issued. From now on its holder acts as the KIND and NAME.
    The bus identifies the holder by the common name (CN). No other key may have the same common name.

    \b
    labos pki admit node rpl/sealer --certificate sealer.pem --key sealer.key
    """
    authority = _find_authority(where, pki)
    entry = authority.admit(_make_identity(where, kind, name, lab), certificate, key)
    _report_folder(authority, entry)


@command.command("list")
@pki_option
@folder_and_json
def list_(where: Where, pki: Path | None) -> None:
    """List all certificates: holder, end of validity, and whether they are revoked."""
    authority = _find_authority(where, pki)
    entries = authority.read_members().entries
    end_with_json([_list_facts(authority, entry) for entry in entries])
    for entry in entries:
        click.echo(f"{entry.identity.shown:<28} {_describe_state(entry):<40} CN {entry.common_name}")
    if not entries:
        click.echo("No certificate was issued yet.")


@command.command("renew")
@click.argument("name")
@address_option
@days_option
@pki_option
@folder_and_json
def renew(where: Where, name: str, address: tuple[str, ...], days: int | None, pki: Path | None) -> None:
    """Issue a new key and certificate for NAME, with the same common name. If another computer uses them,
    copy the folder again; a node there detects the change by itself. The kernel renews its own
    certificate, and those of the nodes that it starts, when a third of their validity is left."""
    authority = _find_authority(where, pki)
    entry = authority.renew(authority.find(name), addresses=address, days=days or 0)
    _report_folder(authority, entry)


@command.command("revoke")
@click.argument("name")
@why_option("The reason, for the list.", required=True)
@pki_option
@folder_and_json
def revoke(where: Where, name: str, why: str, pki: Path | None) -> None:
    """Revoke the certificate NAME. A running lab or bus refuses it within two seconds. If the bus is on
    another computer, copy its folder again. The command also writes a revocation list (crl.pem) for other
    programs. Zenoh does not read it."""
    authority = _find_authority(where, pki)
    entry = authority.revoke(authority.find(name), why)
    message = f"The {entry.identity.shown} can no longer connect with CN {entry.common_name}."
    report_done(message, _list_facts(authority, entry))


def _find_authority(where: Where, pki: Path | None) -> Authority:
    return Authority(Settings(where.home, "", authority=pki).pki)


def _make_identity(where: Where, kind: Any, name: str, lab: str | None) -> PartyIdentity:
    if (kind in ("node", "api", "viewer", "stop")) is not bool(name):
        what = f"An {kind}" if kind == "api" else f"A {kind}"
        raise click.UsageError(f"{what} needs a name." if not name else f"{what} has no name.")
    if kind == "api" and not PROCESS_NAME.fullmatch(name):
        raise click.UsageError(f"{name!r} is not a name for an API process: use a-z, 0-9 and -.")
    if kind == "node" and name.count("/") != 1:
        raise click.UsageError(f"{name!r} is not a node's name: write WORKCELL/MODULE.")
    return PartyIdentity(kind, name, "" if kind == "bus" else lab or _expect_lab_id(where))


def _expect_lab_id(where: Where) -> str:
    if not (found := find_lab_id(where)):
        raise NotFound(
            "There is no log yet, so the lab's id is unknown.",
            remedy="Start the lab once (labos up … --secure), or give its id: --lab-id ID.",
        )
    return found


def _describe_state(entry: CertificateEntry) -> str:
    if entry.revoked_at:
        return f"revoked {show_time(entry.revoked_at)}"
    if entry.not_after < now_ns():
        return f"EXPIRED {show_time(entry.not_after)}"
    due = ", due for renewal" if entry.is_due(now_ns()) else ""
    return f"until {show_time(entry.not_after)}{due}"


def _list_facts(authority: Authority, entry: CertificateEntry) -> dict[str, Any]:
    found: dict[str, Any] = msgspec.to_builtins(entry)
    for name in ("serial", "not_before", "own"):
        del found[name]
    return {**found.pop("identity"), **found, "folder": str(authority.credentials(entry.identity).folder)}


def _report_folder(authority: Authority, entry: CertificateEntry) -> None:
    facts = _list_facts(authority, entry)
    report_done(str(facts["folder"]), facts)
