"""USB devices that receive and send bytes at bulk endpoints, with pyusb."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from labos.errors import LinkLost, NotConnected
from labos.link.wire import needs

PIECE = 512
"""The number of bytes in one request; a multiple of the size of every bulk packet."""
INCOMING = 0x80
"""The bit in the address of an endpoint that sends data to the host."""


class UsbWire:
    """The device with these ids; ``serial`` selects one of several equal devices. By default, the
    endpoints are the first ones of the device. ``backend`` is a backend of pyusb to use instead of
    searching for one."""

    forgets = False

    def __init__(
        self,
        vendor: int,
        product: int,
        *,
        out_end: int = 0,
        in_end: int = 0,
        serial: str = "",
        backend: Any = None,
    ) -> None:
        self.name = f"usb {vendor:04x}:{product:04x}"
        self._ids, self._ends, self._serial = (vendor, product), (out_end, in_end), serial
        self._backend = backend
        self._device: Any = None

    def open(self) -> None:
        try:
            import usb.core
        except ImportError as error:
            raise needs("usb", error) from error
        wanted = {"serial_number": self._serial} if self._serial else {}
        vendor, product = self._ids
        try:
            self._device = usb.core.find(idVendor=vendor, idProduct=product, backend=self._backend, **wanted)
            if self._device is not None:
                self._device.set_configuration()
                self._ends = self._find_ends(self._device)
        except (usb.core.USBError, usb.core.NoBackendError, ValueError) as error:
            self.close()
            raise NotConnected(
                f"{self.name} cannot be opened: {error}.",
                remedy="Install libusb, and allow this user to use the device (a udev rule).",
            ) from error
        if self._device is None:
            raise NotConnected(
                f"{self.name} is not connected.",
                remedy="Check its power and its cable; lsusb lists the connected devices.",
            )

    def _find_ends(self, device: Any) -> tuple[int, int]:
        """Raises ValueError."""
        if all(self._ends):
            return self._ends
        ends = [end.bEndpointAddress for end in device.get_active_configuration()[(0, 0)]]
        incoming = next((end for end in ends if end & INCOMING), None)
        outgoing = next((end for end in ends if not end & INCOMING), None)
        if incoming is None or outgoing is None:
            raise ValueError("it has no bulk endpoints")
        return self._ends[0] or outgoing, self._ends[1] or incoming

    def write(self, data: bytes, timeout_s: float) -> None:
        with self._translate() as device:
            device.write(self._ends[0], data, timeout=_milliseconds(timeout_s))

    def read(self, timeout_s: float) -> bytes:
        import usb.core

        with self._translate() as device:
            try:
                return bytes(device.read(self._ends[1], PIECE, timeout=_milliseconds(timeout_s)))
            except usb.core.USBTimeoutError:
                return b""

    def close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            import usb.util

            with suppress(Exception):  # the device is gone
                usb.util.dispose_resources(device)

    @contextmanager
    def _translate(self) -> Iterator[Any]:
        """The only place where errors of pyusb for an open device are translated."""
        import usb.core

        if self._device is None:
            raise LinkLost(f"{self.name} is not open.", effects="none")
        try:
            yield self._device
        except usb.core.USBError as error:
            raise LinkLost(
                f"{self.name} is gone: {error}.", remedy="Plug it in again, then reset the module."
            ) from error


def _milliseconds(timeout_s: float) -> int:
    """Never zero, which would mean without limit."""
    return max(round(timeout_s * 1000), 1)
