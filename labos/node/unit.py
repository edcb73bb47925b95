"""The serial number of a device, which it reports when it is connected.

Two robots of one model answer alike, but the poses that one was taught are wrong for the other. So a serial
number is pinned: by ``serial:`` in the module's configuration, otherwise by the first unit that was
connected. That number is stored in a file beside the node's journal.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labos.errors import NotConnected, WrongDevice
from labos.private import replace_file

if TYPE_CHECKING:
    from labos.node.node import Setup


def check_unit(setup: Setup, serial: Any) -> None:
    """Compare the serial number that a device reports (empty or None if it reports none) with the pinned one;
    called at each connection. The first serial number is stored. A simulated device is not checked. Raises
    WrongDevice for another unit, NotConnected if the pinned number cannot be read or stored."""
    if setup.world is not None:
        return
    found = "" if serial is None else str(serial).strip()
    module, pinned = f"{setup.workcell}/{setup.name}", str(setup.config.get("serial") or "")
    kept = Path(setup.unit_file) if setup.unit_file else None
    expected = pinned or (read_known_unit(kept) if kept is not None else "")
    if not expected and found and kept is not None:
        keep_unit(kept, found)
    if not expected or found == expected:
        return
    if pinned:
        accept = f"write `serial: {found or '…'}` for {module} in the workcell file"
    else:
        accept = f"run `labos node accept-unit {module} {found}`".rstrip(" `") + "`"
    raise WrongDevice(
        f"{module}: the unit with the serial number {expected} was expected, but "
        + (f"{found} answers." if found else "the connected device reports no serial number."),
        remedy=f"Connect {expected} again; or {accept}, teach the poses that differ, and reset the module.",
    )


def find_pinned_unit(setup: Setup) -> str:
    """The serial number that the module's device has to have; empty if none is pinned or it cannot be
    read."""
    pinned = str(setup.config.get("serial") or "")
    if pinned or setup.world is not None or not setup.unit_file:
        return pinned
    with contextlib.suppress(NotConnected):
        return read_known_unit(Path(setup.unit_file))
    return ""


def read_known_unit(file: Path) -> str:
    """The serial number in a file; empty if there is none. Raises NotConnected."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return str(content["serial"])
    except FileNotFoundError:
        return ""
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise NotConnected(
            f"{file} should contain the device's serial number, but cannot be read ({error}).",
            remedy="Check which device is connected, and remove the file: the serial number of the next "
            "device is stored.",
        ) from error


def keep_unit(file: Path, serial: str) -> None:
    """Store a serial number durably. Raises NotConnected."""
    try:
        replace_file(file, json.dumps({"serial": serial}).encode())
    except OSError as error:
        raise NotConnected(f"The serial number {serial} cannot be stored in {file} ({error}).") from error


def forget_unit(file: Path) -> None:
    """Delete the stored number; the next unit that is connected is stored. Raises NotConnected."""
    try:
        file.unlink(missing_ok=True)
    except OSError as error:
        raise NotConnected(f"{file} cannot be removed ({error}).") from error
