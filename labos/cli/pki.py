"""``labos pki``: certificates for a secure bus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from labos.cli._group import Suggesting
from labos.cli._options import json_option, pki_option, why_option
from labos.cli._out import show_json, tell
from labos.cli._query import Where, log_options, now_ns, open_database
from labos.errors import LabosError, NotFound
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
    "--days", type=click.IntRange(1, 36500), metavar="N", help="For how many days it is valid."
)


@click.group("pki", cls=Suggesting, short_help="Certificates for a secure bus.")
def command() -> None:
    """A small certificate authority for the lab's bus, in the lab's folder (pki/), or what the site issued.

    `labos up --secure` makes one, and certificates for the kernel and the nodes that it starts. These
    commands are for nodes on other computers, for programs that only listen, and for a key that was lost.
    A running lab or bus uses a change within two seconds. The whole procedure: docs/secure-bus.md.

    \b
    labos pki init                          make the authority
    labos pki issue node rpl/sealer         a certificate for a module's node
    labos pki issue viewer dashboard        for a program that only listens
    labos pki list                          all certificates, and when they expire
    labos pki renew rpl/sealer              a new key and certificate under the same name
    labos pki revoke rpl/sealer --why TEXT  its certificate is refused from now on
    """


@command.command("init")
@click.option(
    "--ca",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The certificate of the site's authority (PEM, or several of them): it issues, not LabOS.",
)
@days_option
@pki_option
@json_option
@log_options
def init(where: Where, ca: Path | None, days: int | None, pki: Path | None, as_json: bool) -> None:
    """Make the authority, once. Its private key (ca.key) lets those who read it act as everybody: it may
    be kept offline, and is only needed to issue, renew and revoke."""
    from socket import gethostname

    authority = _authority(where, pki)
    more = {"days": days} if days else {}
    authority.init(f"LabOS authority of {gethostname()}"[:64], site=ca, **more)
    facts = {"folder": str(authority.folder), "issues": authority.issues}
    who = "LabOS issues the certificates" if authority.issues else "the site issues the certificates"
    tell(f"{authority.folder}: {who}.", facts, as_json=as_json)


@command.command("issue")
@kind_argument
@name_argument
@address_option
@days_option
@lab_option
@pki_option
@json_option
@log_options
def issue(
    where: Where,
    kind: Any,
    name: str,
    address: tuple[str, ...],
    days: int | None,
    lab: str | None,
    pki: Path | None,
    as_json: bool,
) -> None:
    """Make a certificate and its key, and print the folder that holds them. Copy that folder to the computer
    where it is used, over a way that nobody can read (scp), and keep its rights.

    KIND is node (NAME is WORKCELL/MODULE), kernel, bus, api (NAME is that of an API process), viewer
    (NAME is what you like), or stop: it may stop modules in an emergency (`labos estop --connect ENDPOINT`),
    and nothing else.

    \b
    labos pki issue node rpl/sealer
    labos pki issue bus --address bus.example.org
    """
    authority = _authority(where, pki)
    identity = _identity(where, kind, name, lab)
    more = {"days": days} if days else {}
    entry = authority.issue(identity, addresses=address, **more)
    _tell_folder(authority, entry, as_json)


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
@json_option
@log_options
def admit(
    where: Where,
    kind: Any,
    name: str,
    certificate: Path,
    key: Path,
    lab: str | None,
    pki: Path | None,
    as_json: bool,
) -> None:
    """Take over a certificate that the site issued: its holder acts as the KIND and NAME from now on.
    The bus knows it by its common name (CN), which no other key may have.

    \b
    labos pki admit node rpl/sealer --certificate sealer.pem --key sealer.key
    """
    authority = _authority(where, pki)
    entry = authority.admit(_identity(where, kind, name, lab), certificate, key)
    _tell_folder(authority, entry, as_json)


@command.command("list")
@pki_option
@json_option
@log_options
def list_(where: Where, pki: Path | None, as_json: bool) -> None:
    """Every certificate: whose it is, until when it is valid, whether it was revoked."""
    authority = _authority(where, pki)
    entries = authority.members().entries
    if as_json:
        show_json([_facts(authority, entry) for entry in entries])
        return
    for entry in entries:
        click.echo(f"{entry.identity.shown:<28} {_state(entry):<40} CN {entry.common_name}")
    if not entries:
        click.echo("No certificate was issued yet.")


@command.command("renew")
@click.argument("name")
@address_option
@days_option
@pki_option
@json_option
@log_options
def renew(
    where: Where, name: str, address: tuple[str, ...], days: int | None, pki: Path | None, as_json: bool
) -> None:
    """Make a new key and certificate for NAME, under the same common name. Copy its folder again if it is
    used on another computer; a node there notices it by itself. The kernel renews its own, and those of the
    nodes that it starts, when a third of their time is left."""
    authority = _authority(where, pki)
    entry = authority.renew(authority.find(name), addresses=address, days=days or 0)
    _tell_folder(authority, entry, as_json)


@command.command("revoke")
@click.argument("name")
@why_option("What happened; it is kept in the list.", required=True)
@pki_option
@json_option
@log_options
def revoke(where: Where, name: str, why: str, pki: Path | None, as_json: bool) -> None:
    """Make the certificate NAME invalid. A running lab or bus opens its bus again without it, in two seconds;
    a bus on another computer needs its folder copied again. A revocation list is
    written too (crl.pem), for others: Zenoh reads none."""
    authority = _authority(where, pki)
    entry = authority.revoke(authority.find(name), why)
    told = f"The {entry.identity.shown} may speak no more with CN {entry.common_name}."
    tell(told, _facts(authority, entry), as_json=as_json)


def _authority(where: Where, pki: Path | None) -> Authority:
    return Authority(Settings(where.home, "", authority=pki).pki)


def _identity(where: Where, kind: Any, name: str, lab: str | None) -> PartyIdentity:
    if (kind in ("node", "api", "viewer", "stop")) is not bool(name):
        what = f"An {kind}" if kind == "api" else f"A {kind}"
        raise click.UsageError(f"{what} needs a name." if not name else f"{what} has no name.")
    if kind == "api" and not PROCESS_NAME.fullmatch(name):
        raise click.UsageError(f"The name of an API process is made of a-z, 0-9 and -, not {name!r}.")
    if kind == "node" and name.count("/") != 1:
        raise click.UsageError(f"A node's name is WORKCELL/MODULE, not {name!r}.")
    return PartyIdentity(kind, name, "" if kind == "bus" else lab or _lab_in(where))


def _lab_in(where: Where) -> str:
    try:
        with open_database(where) as store:
            found = store.head().lab
    except LabosError:
        found = None
    if not found:
        raise NotFound(
            "There is no log yet that could tell the lab's id.",
            remedy="Start the lab once (labos up … --secure), or name its id: --lab-id ID.",
        )
    return str(found)


def _state(entry: CertificateEntry) -> str:
    if entry.revoked_at:
        return f"revoked {show_time(entry.revoked_at)}"
    if entry.not_after < now_ns():
        return f"EXPIRED {show_time(entry.not_after)}"
    due = ", due for renewal" if entry.is_due(now_ns()) else ""
    return f"until {show_time(entry.not_after)}{due}"


def _facts(authority: Authority, entry: CertificateEntry) -> dict[str, Any]:
    return {
        "kind": entry.identity.kind,
        "name": entry.identity.name,
        "lab": entry.identity.lab,
        "common_name": entry.common_name,
        "not_after": entry.not_after,
        "addresses": list(entry.addresses),
        "revoked_at": entry.revoked_at,
        "why": entry.why,
        "folder": str(authority.credentials(entry.identity).folder),
    }


def _tell_folder(authority: Authority, entry: CertificateEntry, as_json: bool) -> None:
    facts = _facts(authority, entry)
    tell(str(facts["folder"]), facts, as_json=as_json)
