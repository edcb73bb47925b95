"""Serial ports, by pyserial: RS-232, RS-485, USB adapters, and converters on the network."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Literal

from labos.errors import LinkLost, NotConnected
from labos.link.wire import needs

if TYPE_CHECKING:
    import serial

Parity = Literal["N", "E", "O", "M", "S"]


class SerialWire:
    """A port by its name (``/dev/ttyUSB0``, ``/dev/serial/by-id/…``, ``COM3``) or as a URL of
    pyserial (``socket://192.168.1.7:4001`` and ``rfc2217://…`` for converters on the network).

    The port is locked: a second program that opens it is refused, or refuses this one.
    """

    forgets = False

    def __init__(
        self,
        port: str,
        *,
        baudrate: int = 9600,
        bytesize: int = 8,
        parity: Parity = "N",
        stopbits: float = 1,
        rtscts: bool = False,
    ) -> None:
        self.port, self.name = port, f"serial {port}"
        self._settings: dict[str, Any] = {
            "baudrate": baudrate,
            "bytesize": bytesize,
            "parity": parity,
            "stopbits": stopbits,
            "rtscts": rtscts,
        }
        if "://" not in port:
            self._settings["exclusive"] = True
        self._device: serial.Serial | None = None

    def open(self) -> None:
        try:
            import serial
        except ImportError as error:
            raise needs("serial", error) from error
        try:
            self._device = serial.serial_for_url(self.port, timeout=0, **self._settings)
        except Exception as error:  # termios has its own error class, which Windows lacks
            raise NotConnected(
                f"{self.name} cannot be opened: {_reason(error)}.",
                remedy="Check the cable, the name of the port, and that no other program uses it.",
            ) from error

    def write(self, data: bytes, timeout_s: float) -> None:
        with self._translate(effects="none") as device:
            device.write_timeout = timeout_s
        with self._translate() as device:
            device.write(data)

    def read(self, timeout_s: float) -> bytes:
        with self._translate() as device:
            device.timeout = timeout_s
            first = device.read(1)
            if not first:
                return b""
            return bytes(first) + bytes(device.read(device.in_waiting) if device.in_waiting else b"")

    def close(self) -> None:
        device, self._device = self._device, None
        if device is None:
            return
        # pyserial does not close a connection to a converter that has closed it already.
        connection = getattr(device, "_socket", None)
        with suppress(Exception):  # the port is gone
            device.close()
        if connection is not None:
            connection.close()

    @contextmanager
    def _translate(self, effects: str = "unknown") -> Iterator[serial.Serial]:
        """The only place where errors of pyserial and the system for an open port are translated.
        ``effects``: the knowledge about the effects of the sent bytes."""
        if self._device is None:
            raise LinkLost(f"{self.name} is not open.", effects="none")
        try:
            yield self._device
        except Exception as error:
            # If a port vanishes, pyserial fails on its own closed descriptor, and passes on errors of
            # termios, which Windows lacks.
            raise LinkLost(
                f"{self.name} is gone: {_reason(error)}.",
                effects=effects,
                remedy="Plug it in again, then reset the module.",
            ) from error


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error).rstrip(".") or type(error).__name__
