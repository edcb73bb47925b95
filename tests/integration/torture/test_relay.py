"""The line in the middle: what it does to what a device says, and what is left of it afterwards."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labos.errors import LinkError
from labos.link import FarEnd, PtyEnd, SerialWire, TcpEnd
from labos.torture.relay import Mode, Relay, Spoiler
from labos.torture.relay_http import open_relay

LIMIT_S = 10.0


class Pair:
    """A device, and whoever has opened the relay to it."""

    def __init__(self, device: FarEnd, relay: Relay) -> None:
        self.device, self.relay = device, relay
        self.wire = SerialWire(relay.address)
        self.wire.open()

    def read_at_device(self) -> bytes:
        """What the device hears next."""
        return _until(lambda: self.device.read(0.2))

    def read_at_driver(self, data: bytes) -> bytes:
        """What arrives of what the device says."""
        self.device.write(data)
        return _until(lambda: self.wire.read(0.2))


def _until(read: Callable[[], bytes]) -> bytes:
    """What is read, to its end: lines bring it in pieces."""
    deadline = time.monotonic() + LIMIT_S
    data = b""
    while not data and time.monotonic() < deadline:
        data = read()
    while more := read():
        data += more
    return data


def _await_spoiled(relay: Relay) -> None:
    """Wait until something has been."""
    assert isinstance(relay, Spoiler)
    deadline = time.monotonic() + LIMIT_S
    while not relay.spoiled_count and time.monotonic() < deadline:
        time.sleep(0.01)


@pytest.fixture(params=["serial", "tcp"])
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Pair]:
    device: FarEnd = PtyEnd() if request.param == "serial" else TcpEnd()
    relay = open_relay(device.address, tmp_path)
    pair = Pair(device, relay)
    pair.wire.write(b"hello", 1.0)
    assert pair.read_at_device() == b"hello"
    yield pair
    pair.wire.close()
    relay.close()
    device.close()


@pytest.mark.parametrize(("mode", "arrives"), [("garble", b"aHcdOf"), ("cut", b"abc")])
def test_what_is_said_is_spoiled_once(pair: Pair, mode: Mode, arrives: bytes) -> None:
    pair.relay.spoil(mode, times=1)
    assert pair.read_at_driver(b"abcdef") == arrives
    assert pair.read_at_driver(b"abcdef") == b"abcdef"


def test_what_is_lost_never_comes_and_what_is_held_comes_late(pair: Pair) -> None:
    pair.relay.spoil("lose", times=1)
    pair.device.write(b"lost")
    _await_spoiled(pair.relay)
    pair.relay.spoil("hold")
    pair.device.write(b"late")
    _await_spoiled(pair.relay)
    assert pair.wire.read(0.1) == b""
    pair.relay.restore()
    assert _until(lambda: pair.wire.read(0.05)) == b"late"


def test_who_is_connected_notices_that_it_is_unplugged_and_may_come_back(pair: Pair) -> None:
    pair.relay.unplug()

    def talk() -> None:
        for _ in range(100):
            pair.wire.read(0.05)
            pair.wire.write(b"?", 1.0)

    with pytest.raises(LinkError):
        talk()
    pair.wire.close()
    with pytest.raises(LinkError):
        pair.wire.open()
    pair.relay.plug()
    pair.wire.open()
    deadline = time.monotonic() + LIMIT_S
    while b"back" not in pair.device.read(0.05) and time.monotonic() < deadline:
        with contextlib.suppress(LinkError):
            pair.wire.write(b"back", 1.0)
    assert pair.read_at_driver(b"welcome") == b"welcome"


def test_a_device_with_two_lines_is_cut_off_from_both(tmp_path: Path) -> None:
    devices: list[Any] = [PtyEnd(), TcpEnd()]
    relay = open_relay(",".join(device.address for device in devices), tmp_path)
    wires = [SerialWire(address) for address in relay.address.split(",")]
    for device, wire in zip(devices, wires, strict=True):
        wire.open()
        wire.write(b"hello", 1.0)
        assert _until(partial(device.read, 0.2)) == b"hello"
    relay.spoil("cut", times=1)
    for device, wire in zip(devices, wires, strict=True):
        device.write(b"abcdef")
        assert _until(partial(wire.read, 0.2)) == b"abc"
    relay.unplug()
    for wire in wires:
        wire.close()
        with pytest.raises(LinkError):
            wire.open()
    relay.plug()
    for wire in wires:
        wire.open()
    relay.reach("")
    relay.close()
    for end in (*wires, *devices):
        end.close()
