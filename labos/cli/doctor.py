"""``labos doctor``: checks everything that a lab needs."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import click

from labos.cli._exit import DONE, FAILED
from labos.cli._out import end_with_json
from labos.cli._query import Where, folder_and_json, now_ns, open_log
from labos.client import LabClient
from labos.core.lengths import find_drifts
from labos.errors import LabosError
from labos.pki import Authority
from labos.services.doctor import (
    DoctorFinding,
    check_calibrations,
    check_certificates,
    check_durations,
    check_nodes,
    check_permissions,
    check_rehearsal,
    check_retention,
    check_space,
    check_sync,
)
from labos.services.history import fold_state_at
from labos.services.times import show_time
from labos.services.trust.places import find_newest
from labos.services.trust.publish import FOLDER
from labos.settings import KernelInfo, Settings, find_kernel, is_free, last_kernel, last_ports
from labos.store import find_database_file, find_lease_holder, read_database_status, show_url
from labos.version import VERSION

MARKS = {"ok": "ok     ", "warning": "WARNING", "fault": "FAULT  "}

PRIVATE = ("labos.db", "labos.key", "labos.head", "keys", "blobs", "journals", "contacts.yaml", "nodes.yaml")

LONG_AGO_S = 7 * 86_400.0


@click.command("doctor", short_help="Check the lab's database, disk, network, nodes and backups.")
@folder_and_json
def command(where: Where) -> None:
    """Check database, disk, permissions, ports, kernel, bus, clocks, nodes, checkpoints, backups and
    calibrations, and report a remedy for each problem. The command moves and changes nothing. It works with
    and without a running kernel. Exit code 1 if there is a fault.

    \b
    labos doctor
    labos doctor --json
    labos doctor --home /var/lib/labos/lab
    """
    found = list(_examine(where))
    faults = sum(finding.state == "fault" for finding in found)
    end_with_json({"well": not faults, "findings": found}, FAILED if faults else DONE)
    for finding in found:
        click.echo(f"{MARKS[finding.state]} {finding.result}")
        if finding.remedy:
            click.echo(f"{' ' * 8}{finding.remedy}")
    warnings = sum(finding.state == "warning" for finding in found)
    click.echo(f"{len(found)} checks: {faults} faults, {warnings} warnings.")
    if faults:
        click.get_current_context().exit(FAILED)


def _fail(part: str, result: str, remedy: str) -> DoctorFinding:
    return DoctorFinding(part, "fault", result, remedy)


def _warn(part: str, result: str, remedy: str) -> DoctorFinding:
    return DoctorFinding(part, "warning", result, remedy)


def _examine(where: Where) -> Iterator[DoctorFinding]:
    kernel = find_kernel(where.home)
    yield _check_database(where)
    if not where.home.is_dir():
        message = f"There is no folder {where.home}."
        yield _fail("home", message, "Name the lab's folder (--home), or start a lab: labos up")
        return
    file = find_database_file(where.url)
    disk = file.parent if file is not None and file.parent.is_dir() else where.home
    yield from _examine_safely("disk space", lambda: check_space(disk))
    yield from _examine_safely("disk sync", lambda: check_sync(disk))
    authority = Authority(Settings.make(where.home).pki)
    private = [where.home, *(where.home / name for name in PRIVATE), *authority.list_private_files()]
    yield from _examine_safely("permissions", lambda: check_permissions(private))
    yield from _check_lab_certificates(authority)
    yield from _check_ports(where.home, kernel)
    if kernel is None:
        yield _explain_no_kernel(where)
    else:
        yield from _check_kernel(where.home, kernel)
    yield _check_checkpoint(where.home)
    yield check_rehearsal(where.home, now_ns())
    if (retention := check_retention(where.home, now_ns())) is not None:
        yield retention
    yield from _check_state(where)


def _examine_safely(name: str, look: Callable[[], DoctorFinding]) -> Iterator[DoctorFinding]:
    """If a check cannot be made, that is a fault too."""
    try:
        yield look()
    except OSError as error:
        yield _fail(name, f"This check failed: {error}.", "Run the command as the owner of the lab.")


def _check_database(where: Where) -> DoctorFinding:
    try:
        found = read_database_status(where.url)
    except LabosError as error:
        message = f"The database {show_url(where.url)} cannot be used: {error.message}"
        return _fail("database", message, error.remedy)
    message = (
        f"The {found.name} is at revision {found.revision or 'none'}; this LabOS needs {found.expected}."
    )
    match found.state:
        case "current":
            return DoctorFinding("database", "ok", message)
        case "missing" | "empty":
            message = f"There is no log in {show_url(where.url)} yet."
            return _warn("database", message, "labos up creates one. Or give the right --home.")
        case "older":
            return _fail("database", message, "Make a backup, then run: labos db upgrade")
    return _fail("database", message, "Install the newer LabOS that wrote it.")


def _check_state(where: Where) -> Iterator[DoctorFinding]:
    """Whether actions take as long as planned and calibrations are valid, if there is a readable log."""
    try:
        if read_database_status(where.url).state != "current":
            return
        with open_log(where) as store:
            state = fold_state_at(store)
    except LabosError:
        return  # another check reports the fault of the log
    yield check_durations(find_drifts(state.lengths, state.lab.pace))
    yield from check_calibrations(state, now_ns())


def _check_ports(home: Path, kernel: KernelInfo | None) -> Iterator[DoctorFinding]:
    ports = last_ports(home)
    if kernel is None:
        for name, port in (("HTTP", ports.http), ("bus", ports.bus)):
            if port and not is_free(port):
                message = f"Another program listens on {port}, the lab's port for {name}."
                remedy = f"End that program, or use another port: labos up --{name.lower()}-port PORT"
                yield _fail("ports", message, remedy)
        return
    endpoint = urlsplit(kernel.bus.replace("/", "://", 1))
    try:
        socket.create_connection((endpoint.hostname or "", endpoint.port or 0), timeout=2.0).close()
        yield _check_bus(kernel.bus, endpoint.hostname or "")
    except (OSError, ValueError) as error:
        message = f"The bus does not answer at {kernel.bus}: {error}."
        yield _fail("bus", message, "Start it (labos bus), and check the firewall between the hosts.")


def _check_bus(where: str, host: str) -> DoctorFinding:
    from labos.http.server import is_own_address

    message = f"The bus answers at {where}."
    if where.startswith("tls/") or is_own_address(host):
        return DoctorFinding("bus", "ok", message)
    message = f"{message} Other computers can reach it without authentication."
    return _warn("bus", message, "labos up --secure; see docs/secure-bus.md.")


def _check_lab_certificates(authority: Authority) -> Iterator[DoctorFinding]:
    if not authority.exists:
        return
    try:
        yield from check_certificates(authority, now_ns())
    except LabosError as error:
        yield _fail("certificates", f"They cannot be checked: {error.message}", error.remedy)


def _explain_no_kernel(where: Where) -> DoctorFinding:
    try:
        owner = find_lease_holder(where.url)
    except LabosError:
        owner = ""
    if owner:
        message = f"Another kernel ({owner}) writes this log, and does not answer here."
        return _warn("kernel", message, "It runs on another computer, or is frozen. Check it there.")
    last = last_kernel(where.home)
    if last is not None and last.pid:
        message = (
            f"The last kernel of this lab (pid {last.pid}) ended unexpectedly: it was killed, or crashed."
        )
        return _warn("kernel", message, "Read the journal of its service, then start it again: labos up")
    return DoctorFinding("kernel", "ok", "No kernel runs this lab. The last one ended normally.")


def _check_kernel(home: Path, kernel: KernelInfo) -> Iterator[DoctorFinding]:
    try:
        with LabClient(home=home, patience_s=5.0) as client:  # the folder's owner may read
            health = client.health()
            heard = client.check_nodes()
    except LabosError as error:
        yield _fail("kernel", f"The kernel at {kernel.url} says: {error.message}", error.remedy)
        return
    yield _check_health(kernel, health)
    for driver, why in health.get("broken_drivers", {}).items():
        message = f"The driver {driver} cannot be loaded: {why}"
        yield _warn("drivers", message, "Install the packages that it needs, if a module uses this driver.")
    yield from check_nodes(heard, VERSION)


def _check_health(kernel: KernelInfo, health: dict[str, Any]) -> DoctorFinding:
    check = health.get("log_check") or {}
    if check.get("damage"):
        message = f"The log is damaged. {check['damage']}"
        return _fail("log", message, "Do not change it. Check it with labos verify, then restore a backup.")
    if health.get("status") != "ok" or health.get("suspended"):
        message = (
            f"The kernel at {kernel.url} does not write: {health.get('suspended') or health.get('status')}."
        )
        return _fail(
            "kernel",
            message,
            "Check its database. The kernel continues when the database is available again.",
        )
    return DoctorFinding(
        "kernel", "ok", f"The kernel at {kernel.url} runs; the log is at {health['position']}."
    )


def _check_checkpoint(home: Path) -> DoctorFinding:
    newest = find_newest(home / FOLDER)
    if newest is None:
        message = "No checkpoint of the log was signed yet. Without one, other people cannot verify the log."
        return _warn("checkpoints", message, "labos key create, then labos checkpoint --follow --to PLACE")
    made_ns = int(newest.stat().st_mtime * 1e9)
    message = f"The newest checkpoint is {newest.name}, of {show_time(made_ns)}."
    if now_ns() - made_ns > LONG_AGO_S * 1e9:
        return _warn("checkpoints", message, "Check whether labos checkpoint --follow still runs.")
    return DoctorFinding("checkpoints", "ok", message)
