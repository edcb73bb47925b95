"""The checks of ``labos doctor``, each with a remedy."""

from __future__ import annotations

import contextlib
import os
import shutil
import statistics
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from labos.core.calibrations import WARN_DAYS
from labos.core.ids import local
from labos.core.lengths import Drift
from labos.core.state import LabState
from labos.pki import Authority, CertificateEntry
from labos.private import create_file, replace_file
from labos.services.times import show_time

LITTLE_BYTES, LEAST_BYTES = 5 << 30, 500 << 20
"""Bytes of free space: below the first, a warning; below the second, an error."""

SLOW_SYNC_S, SLOWEST_SYNC_S = 0.02, 0.2
"""How long a disk may take to make one small write durable (warning, error): each action takes three such
writes."""

SYNCS = 15
CLOCK_OFF_S, CLOCK_WRONG_S = 0.5, 5.0
"""Difference of clocks (warning, error): a result is not accepted without a question if its time is 10 s
outside the possible time."""

CA_LITTLE_NS = 90 * 86_400 * 10**9
"""All certificates of a lab expire with the certificate of their authority: so long before, a warning asks
for a new one."""

REHEARSAL = "rehearsal.json"
"""A file in the lab's folder: when a restore was last rehearsed."""

LONG_UNREHEARSED_NS = 100 * 86_400 * 10**9

State = Literal["ok", "warning", "fault"]


class DoctorFinding(msgspec.Struct, frozen=True):
    """One check. ``result`` is what was found, in a sentence; ``remedy`` is what to do (empty if all is
    well)."""

    name: str
    state: State
    result: str
    remedy: str = ""


def grade(
    name: str, result: str, remedy: str, *, fault: bool = False, warning: bool = False
) -> DoctorFinding:
    """The finding of a check; its remedy only if something is wrong."""
    state: State = "fault" if fault else "warning" if warning else "ok"
    return DoctorFinding(name, state, result, "" if state == "ok" else remedy)


MOST_NAMED = 5
"""At most so many calibrations that expire are named."""

MOST_DRIFTS = 5
"""At most so many actions with a drift are named."""


def check_space(folder: Path) -> DoctorFinding:
    """Free space on the disk of a folder."""
    free = shutil.disk_usage(folder).free
    result = f"{free / 1e9:.1f} GB are free on the disk of {folder}."
    if free < LEAST_BYTES:
        remedy = "Make room: the kernel stops when its log cannot be written."
        return DoctorFinding("disk space", "fault", result, remedy)
    return grade("disk space", result, "Make room before it runs out.", warning=free < LITTLE_BYTES)


def check_rehearsal(home: Path, now_ns: int) -> DoctorFinding:
    """When a rehearsal last showed that a backup can be restored."""
    remedy = "labos restore FOLDER --rehearse"
    try:
        found = msgspec.json.decode((home / REHEARSAL).read_bytes())
        at, folder, position, took = found["at"], found["folder"], found["position"], found["took_s"]
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, KeyError, TypeError):
        return DoctorFinding("backup", "warning", "No backup has been restored as a test yet.", remedy)
    result = (
        f"On {show_time(at)} the backup in {folder} was restored as a test, up to position "
        f"{position}, in {took:.1f} s."
    )
    return grade("backup", result, remedy, warning=now_ns - at > LONG_UNREHEARSED_NS)


def check_durations(found: Sequence[Drift]) -> DoctorFinding:
    """Whether actions take about as long as planned."""
    if not found:
        return DoctorFinding(
            "durations", "ok", "Actions take about as long as their drivers or workflows say."
        )
    named = [
        f"{drift.module}.{drift.action} takes {drift.takes_s:.3g} s, planned {drift.planned_s:.3g} s"
        for drift in found[:MOST_DRIFTS]
    ]
    more = f"; and {len(found) - MOST_DRIFTS} more" if len(found) > MOST_DRIFTS else ""
    result = f"{'; '.join(named)}{more}. The scheduler uses the measured times."
    return DoctorFinding("durations", "warning", result, "Check the device, or correct its `duration`.")


def check_calibrations(state: LabState, now_ns: int) -> list[DoctorFinding]:
    """Whether calibrations of modules have expired, or will soon; empty if no calibration has a last day."""
    dated = [
        (f"{local(name)}{f' ({what})' if what else ''}", one)
        for name, module in state.modules.by_name.items()
        for what, one in module.calibrations.items()
        if one.until
    ]
    if not dated:
        return []
    soon = sorted((one.until, of, one) for of, one in dated if one.expires_soon(now_ns))
    if not soon:
        result = f"Of {len(dated)} calibrations none expires within {WARN_DAYS} days."
        return [DoctorFinding("calibrations", "ok", result)]
    named = [
        f"{of} {'has expired: it was' if one.has_expired(now_ns) else 'is'} valid until {until}"
        for until, of, one in soon[:MOST_NAMED]
    ]
    more = f"; and {len(soon) - MOST_NAMED} more" if len(soon) > MOST_NAMED else ""
    result = f"Calibrations: {'; '.join(named)}{more}. No run waits for that."
    remedy = "Calibrate; then: labos calibrate MODULE --until DATE"
    return [DoctorFinding("calibrations", "warning", result, remedy)]


def check_sync(folder: Path) -> DoctorFinding:
    """How long the disk of a folder takes to make 4 KB durable. Raises OSError if it cannot be written."""
    path = folder / f".doctor.{os.getpid()}"
    took = []
    try:
        with create_file(path) as file:
            for _ in range(SYNCS):
                file.write(bytes(4096))
                file.flush()
                before = time.perf_counter()
                os.fsync(file.fileno())
                took.append(time.perf_counter() - before)
    finally:
        path.unlink(missing_ok=True)
    median = statistics.median(took)
    result = f"A small write is durable after {median * 1e3:.1f} ms (median of {SYNCS})."
    remedy = "Put the database on a local SSD: an action takes three such writes."
    return grade("disk sync", result, remedy, fault=median > SLOWEST_SYNC_S, warning=median > SLOW_SYNC_S)


def check_permissions(paths: Iterable[Path]) -> DoctorFinding:
    """Whether private files can be read by others than their owner, and whether we are the owner."""
    if sys.platform == "win32":
        return DoctorFinding("permissions", "ok", "Windows: the rights of the user's own folder apply.")
    there = [path for path in paths if path.exists()]
    foreign = [path for path in there if path.stat().st_uid != os.getuid()]
    if foreign and os.getuid() != 0:
        result = f"{foreign[0]} belongs to another user."
        return DoctorFinding(
            "permissions", "fault", result, "Run LabOS as the user who owns the lab's folder, or chown it."
        )
    users = {path.stat().st_uid for path in there}
    if len(users) > 1:
        result = f"The files in {there[0]} belong to several users."
        return DoctorFinding("permissions", "fault", result, "chown -R to the user who runs the lab.")
    open_ = [path for path in there if path.stat().st_mode & 0o077]
    if open_:
        result = f"Others may read {open_[0]}{f' and {len(open_) - 1} more' if len(open_) > 1 else ''}."
        return DoctorFinding("permissions", "fault", result, f"chmod -R go= {open_[0]}")
    return DoctorFinding(
        "permissions", "ok", f"{len(there)} private files and folders can be read only by their owner."
    )


def check_certificates(authority: Authority, now_ns: int) -> list[DoctorFinding]:
    """Whether the certificates of a secure bus are valid, and for how long. Raises LabosError if their list
    cannot be read."""
    admitted = authority.read_members().admitted
    found = [finding for entry in admitted if (finding := _check_certificate(entry, now_ns))]
    ends = authority.find_end()
    if ends - now_ns < CA_LITTLE_NS:
        result = (
            f"The authority in {authority.folder} ends {show_time(ends)}, and all its certificates end then."
        )
        remedy = "Make another authority (labos pki init --pki FOLDER), and issue all certificates again."
        found.append(grade("authority", result, remedy, fault=ends <= now_ns, warning=True))
    if not found:
        first = min((entry.not_after for entry in admitted), default=ends)
        result = f"{len(admitted)} certificates of the bus are valid, the first ends {show_time(first)}."
        found.append(DoctorFinding("certificates", "ok", result))
    return found


def _check_certificate(entry: CertificateEntry, now_ns: int) -> DoctorFinding | None:
    name, whose = f"certificate {entry.common_name}", f"The certificate of the {entry.identity.shown}"
    remedy = "labos pki renew, and copy its folder if it is used on another computer."
    if not entry.own:
        remedy = "Ask the site for a new one with the same CN: labos pki admit."
    if entry.not_after <= now_ns:
        return DoctorFinding(name, "fault", f"{whose} has expired: it is refused.", remedy)
    if entry.is_due(now_ns):
        return DoctorFinding(name, "warning", f"{whose} ends {show_time(entry.not_after)}.", remedy)
    return None


def check_nodes(heard: Iterable[Mapping[str, Any]], version: str) -> list[DoctorFinding]:
    """Checks the answers of nodes (``GET /nodes?check=1``): whether they answer, their version, and their
    clock."""
    return [finding for one in heard for finding in _check_node(one, version)]


def _check_node(one: Mapping[str, Any], version: str) -> list[DoctorFinding]:
    name, answer, checked = str(one["name"]), str(one["answer"]), one.get("checked")
    about = f"node {name}"
    found = []
    if answer in ("IDLE", "BUSY"):
        found.append(DoctorFinding(about, "ok", f"{name} answers: {answer}."))
    else:
        result = f"{name} cannot work ({answer}): {str(one.get('why', '')).rstrip('.')}."
        remedy = f"labos nodes --check {name} shows what to do."
        found.append(grade(about, result, remedy, fault=answer != "out", warning=True))
    if not checked:
        return found
    if checked["labos"] and checked["labos"] != version:
        result = f"The node of {name} is LabOS {checked['labos']}, the kernel {version}."
        found.append(
            DoctorFinding(f"version {name}", "warning", result, "Install the same version on its computer.")
        )
    ahead = checked.get("clock_ahead_s")
    if ahead is not None and abs(ahead) > CLOCK_OFF_S:
        side = "ahead of" if ahead > 0 else "behind"
        result = f"The clock of {name}'s computer is {abs(ahead):.1f} s {side} the kernel's."
        remedy = "Let both follow the same time server (chrony, NTP)."
        found.append(grade(f"clock {name}", result, remedy, fault=abs(ahead) > CLOCK_WRONG_S, warning=True))
    return found


NOTE = "retention.json"
"""A file in the lab's folder: when old segments of the backup were last moved, and when unused files were
last removed."""

LONG_AGO_NS = 45 * 86_400 * 10**9
"""Both steps should be done every month."""

Step = Literal["moved_at", "removed_at"]


class Retention(msgspec.Struct, frozen=True):
    """Times in UTC nanoseconds; 0: never."""

    moved_at: int = 0
    removed_at: int = 0


def note_retention(home: Path, step: Step, now_ns: int) -> None:
    """Note that a step was done. If the note cannot be written, the doctor will later report the step as not
    done."""
    found = _read_retention(home) or Retention()
    noted = msgspec.structs.replace(found, **{step: now_ns})
    with contextlib.suppress(OSError):
        replace_file(home / NOTE, msgspec.json.encode(noted) + b"\n")


def check_retention(home: Path, now_ns: int) -> DoctorFinding | None:
    """Whether both steps were done recently. None for a lab that has never done one: it may intend to keep
    everything."""
    found = _read_retention(home)
    if found is None:
        return None
    steps = (("Old segments were moved", found.moved_at), ("unused files removed", found.removed_at))
    result = ", ".join(f"{what} {f'on {show_time(at)}' if at else 'never'}" for what, at in steps) + "."
    remedy = "Why did it stop? systemctl status labos-retention (docs/backup.md)"
    return grade("retention", result, remedy, warning=now_ns - min(at for _, at in steps) > LONG_AGO_NS)


def _read_retention(home: Path) -> Retention | None:
    """The note; None if there is none, or if it cannot be read."""
    try:
        return msgspec.json.decode((home / NOTE).read_bytes(), type=Retention)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return None
