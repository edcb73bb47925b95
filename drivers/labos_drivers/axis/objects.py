"""The objects of one drive, which are read and written by service data objects (SDO)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from labos.errors import DeviceError, Garbled, LinkError
from labos.link import SdoLink
from labos_drivers.axis import profile
from labos_drivers.axis.profile import meaning_of, state_of

ANSWER_S = 1.0
WHO = "a drive of the profile CiA 402"


class Drive:
    """A drive on the bus. ``emergency`` is the error code of its last emergency message; 0 if none came."""

    def __init__(
        self,
        name: str,
        channel: str,
        config: Mapping[str, Any],
        check_unit: Callable[[str], None],
        *,
        simulated: bool,
    ) -> None:
        self.name = name
        self.emergency = 0
        self.link = SdoLink(
            int(config.get("node", 1)),
            name=name,
            late_s=float(config.get("late_s", 0.5)),
            emergency=self._note_emergency,
            identify=lambda link: _recognise(link, check_unit),
            expected=WHO,
            **_bus_settings(config, channel, simulated=simulated),
        )

    def read_status(self) -> int:
        """The statusword. Raises LinkError, DeviceError."""
        status = self.read(profile.STATUS, 2) & 0xFFFF
        try:
            state_of(status)
        except ValueError as error:
            raise Garbled(f"{self.name}: {error}.", remedy="Check the CAN adapter and its cable.") from error
        return status

    def read(self, index: int, size: int, subindex: int = 0) -> int:
        """The value of an object: a signed number of ``size`` bytes. Raises LinkError, DeviceError."""
        data = self.link.upload(index, subindex, timeout_s=ANSWER_S)
        if len(data) != size:
            raise DeviceError(
                f"{self.name}: object {index:04X} has {len(data)} bytes, and should have {size}.",
                remedy="Compare the drive's manual with the profile CiA 402.",
            )
        return int.from_bytes(data, "little", signed=True)

    def write(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        """Write a number of ``size`` bytes to an object. Raises LinkError, DeviceError."""
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        self.link.download(index, subindex, data, timeout_s=ANSWER_S)

    def read_fault(self) -> DeviceError:
        """The fault that the drive reports: the error code in object 603F, else that of the last emergency
        message. Raises LinkError, DeviceError."""
        code = self.read(profile.ERROR_CODE, 2) & 0xFFFF or self.emergency
        why, remedy = meaning_of(code)
        return DeviceError(f"{self.name}: {why} (error {code:04X}).", remedy=remedy)

    def _note_emergency(self, data: bytes) -> None:
        self.emergency = int.from_bytes(data[:2], "little")


def _bus_settings(config: Mapping[str, Any], channel: str, *, simulated: bool) -> dict[str, Any]:
    """The settings of python-can for the bus."""
    interface = "slcan" if simulated else str(config.get("interface", "socketcan"))
    settings: dict[str, Any] = {"interface": interface, "channel": channel}
    if "bitrate" in config:
        settings["bitrate"] = int(config["bitrate"])
    if interface == "slcan":
        settings["timeout"] = 0.05  # python-can's default reads the port 1000 times a second
    if simulated:
        settings["sleep_after_open"] = 0
    return settings | dict(config.get("bus") or {})


def _recognise(link: SdoLink, check_unit: Callable[[str], None]) -> str:
    kind = int.from_bytes(link.upload(profile.DEVICE_TYPE, timeout_s=ANSWER_S), "little") & 0xFFFF
    if kind != profile.PROFILE:
        return f"a device of the profile {kind}"
    check_unit(_read_serial(link))
    return WHO


def _read_serial(link: SdoLink) -> str:
    """The serial number from CiA 301's identity object; empty if the drive has none. Raises LinkError."""
    try:
        number = int.from_bytes(link.upload(profile.IDENTITY, 4, timeout_s=ANSWER_S), "little")
    except LinkError:
        raise
    except DeviceError:
        return ""
    return str(number) if number else ""
