"""Bulk endpoints through pyusb itself, with a device that answers in the place of libusb."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from labos.errors import DeviceError, LinkLost, NotConnected
from labos.link import UsbWire
from labos.node import World
from labos_drivers.sciclops import driver as sciclops_driver
from labos_drivers.sciclops.driver import USB_IN, USB_OUT, USB_PRODUCT, USB_VENDOR, SciclopsDriver
from labos_drivers.sciclops.wire import SciclopsOnWire
from tests.drivers.wires import run, setup_of

pytest.importorskip("usb", reason="pyusb is not installed (it is with the extra `usb`)")

import usb.backend
import usb.core

NO_DEVICE, TIMED_OUT = 19, 110


class UsbBus(usb.backend.IBackend):  # type: ignore[misc]
    """A bus with one device on it, which is the far end of a line as well."""

    address = "usb"

    def __init__(self, vendor: int = USB_VENDOR, product: int = USB_PRODUCT) -> None:
        self.ids = vendor, product
        self.plugged = True
        self._out, self._in = bytearray(), bytearray()
        self._turn = threading.Condition()

    # -- the device's side -------------------------------------------------------------------

    def read(self, timeout_s: float) -> bytes:
        with self._turn:
            self._turn.wait_for(lambda: self._out, timeout_s)
            data = bytes(self._out)
            self._out.clear()
            return data

    def write(self, data: bytes) -> None:
        with self._turn:
            self._in += data
            self._turn.notify_all()

    def unplug(self) -> None:
        self.plugged = False

    def plug(self) -> None:
        self.plugged = True

    close = unplug

    # -- what libusb would do ----------------------------------------------------------------

    def enumerate_devices(self) -> Any:
        return iter(["sciclops"] if self.plugged else [])

    def get_device_descriptor(self, dev: Any) -> Any:
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x200, bDeviceClass=255, bDeviceSubClass=0,
            bDeviceProtocol=0, bMaxPacketSize0=64, idVendor=self.ids[0], idProduct=self.ids[1], bcdDevice=0,
            iManufacturer=0, iProduct=0, iSerialNumber=0, bNumConfigurations=1, address=1, bus=1,
            port_number=1, port_numbers=(1,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: Any, config: int) -> Any:
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=32, bNumInterfaces=1, bConfigurationValue=1,
            iConfiguration=0, bmAttributes=0x80, bMaxPower=50, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: Any, intf: int, alt: int, config: int) -> Any:
        if alt > 0:
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=2,
            bInterfaceClass=255, bInterfaceSubClass=0, bInterfaceProtocol=0, iInterface=0,
            extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: Any, ep: int, intf: int, alt: int, config: int) -> Any:
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=(USB_OUT, USB_IN)[ep], bmAttributes=2,
            wMaxPacketSize=64, bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: Any) -> Any:
        return dev

    def close_device(self, dev_handle: Any) -> None: ...

    def set_configuration(self, dev_handle: Any, config_value: int) -> None: ...

    def claim_interface(self, dev_handle: Any, intf: int) -> None: ...

    def release_interface(self, dev_handle: Any, intf: int) -> None: ...

    def bulk_write(self, dev_handle: Any, ep: int, intf: int, data: Any, timeout: int) -> int:
        self._needs_plug()
        assert ep == USB_OUT
        with self._turn:
            self._out += bytes(data)
            self._turn.notify_all()
        return len(data)

    def bulk_read(self, dev_handle: Any, ep: int, intf: int, buff: Any, timeout: int) -> int:
        self._needs_plug()
        assert ep == USB_IN
        with self._turn:
            if not self._turn.wait_for(lambda: self._in, timeout / 1000):
                raise usb.core.USBTimeoutError("Operation timed out", None, TIMED_OUT)
            size = min(len(self._in), len(buff))
            buff[:size] = type(buff)("B", bytes(self._in[:size]))
            del self._in[:size]
            return size

    def _needs_plug(self) -> None:
        if not self.plugged:
            raise usb.core.USBError("No such device (it may have been disconnected)", None, NO_DEVICE)


def test_a_sciclops_at_its_bulk_endpoints(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = UsbBus()
    monkeypatch.setattr(sciclops_driver, "UsbWire", lambda *ids, **ends: UsbWire(*ids, **ends, backend=bus))
    device = SciclopsOnWire(setup_of("sciclops", world, 2000), bus)
    device.start()
    (plate,) = world.stock("sciclops.tower1", "plate")

    async def body() -> None:
        driver = SciclopsDriver(setup_of("sciclops", None), "usb")
        await driver.connect()
        await driver.get_plate("tower1", "exchange")
        bus.unplug()
        with pytest.raises(LinkLost, match="usb 7513:0002 is gone"):
            await driver.is_idle()
        with pytest.raises(NotConnected, match="is not connected") as told:
            await driver.transfer("exchange", "tower1")
        assert told.value.effects == "none"
        await driver.close()

    run(body)
    device.close()
    assert world.at("sciclops.exchange") == [plate]


def test_endpoints_that_nobody_named_are_found() -> None:
    bus = UsbBus()
    wire = UsbWire(USB_VENDOR, USB_PRODUCT, backend=bus)
    wire.open()
    wire.write(b"STATUS\r\n", 1.0)
    assert bus.read(1.0) == b"STATUS\r\n"
    bus.write(b"0000\r\n")
    assert wire.read(1.0) == b"0000\r\n"
    wire.close()


def test_a_bus_without_the_device() -> None:
    bus = UsbBus()
    bus.unplug()
    wire = UsbWire(USB_VENDOR, USB_PRODUCT, out_end=USB_OUT, in_end=USB_IN, backend=bus)
    with pytest.raises(NotConnected, match="is not connected"):
        wire.open()
    with pytest.raises(DeviceError, match="is not open"):
        wire.read(0.01)
    wire.close()
