"""When old segments of the backup were last moved, and when unused files were last removed: a note in the
lab's folder, which ``labos doctor`` reads."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Literal

import msgspec

from labos.private import replace_file
from labos.services.doctor import DoctorFinding, grade
from labos.services.times import show_time

NOTE = "retention.json"
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
    found = _read(home) or Retention()
    noted = msgspec.structs.replace(found, **{step: now_ns})
    with contextlib.suppress(OSError):
        replace_file(home / NOTE, msgspec.json.encode(noted) + b"\n")


def check_retention(home: Path, now_ns: int) -> DoctorFinding | None:
    """Whether both steps were done recently. None for a lab that has never done one: it may intend to keep
    everything."""
    found = _read(home)
    if found is None:
        return None
    steps = (("Old segments were moved", found.moved_at), ("unused files removed", found.removed_at))
    result = ", ".join(f"{what} {f'on {show_time(at)}' if at else 'never'}" for what, at in steps) + "."
    remedy = "Why did it stop? systemctl status labos-retention (docs/backup.md)"
    return grade("retention", result, remedy, warning=now_ns - min(at for _, at in steps) > LONG_AGO_NS)


def _read(home: Path) -> Retention | None:
    """The note; None if there is none, or if it cannot be read."""
    try:
        return msgspec.json.decode((home / NOTE).read_bytes(), type=Retention)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return None
