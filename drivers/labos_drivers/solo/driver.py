"""Drives a SOLO through a gateway to its maker's program."""

from __future__ import annotations

import functools
from pathlib import Path

from labos.errors import DeviceError
from labos_drivers.gateway.driver import GatewayDriver
from labos_drivers.solo import protocol

LARGEST = 1024 * 1024


class SoloDriver(GatewayDriver):
    """The protocol goes to the gateway whole; the end is that the program was busy and is idle again."""

    instrument = "solo"

    async def run_protocol(self, path: str) -> None:
        name, text = await self.run(functools.partial(_read, self.name, Path(path)))
        await self.call("run_protocol", name=name, text=text)


def _read(driver: str, file: Path) -> tuple[str, str]:
    """Name and text of a protocol. Raises DeviceError for one that the program would not take."""
    why, text = "there is no such file", ""
    if file.is_file():
        data = file.read_bytes()
        text = data.decode("utf-8", "replace")
        why = f"it has {len(data)} bytes, more than {LARGEST}" if len(data) > LARGEST else ""
        why = why or protocol.wrong_in(text)
    if why:
        raise DeviceError(
            f"{driver}: {file.name} cannot be run: {why}.",
            effects="none",
            remedy="Write it again with SOLOSoft, or split it.",
        )
    return file.name, text
