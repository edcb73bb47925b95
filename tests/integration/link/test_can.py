"""CAN over python-can's virtual bus and over slcan on a pseudo-terminal; SDO against a canopen node."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

from labos.errors import DeviceError, LinkLost, NoReply, NotConnected, WrongDevice
from labos.link import CanLink, CanMessage, PtyEnd, SdoLink, keep_transcript, read_transcript

CHANNELS = itertools.count(1)


@pytest.fixture
def channel() -> str:
    return f"labos-{next(CHANNELS)}"


@pytest.fixture
def node(channel: str) -> Iterator[Any]:
    """A CANopen node with a target position and a read-only serial number."""
    dictionary = canopen.ObjectDictionary()
    for index, name, kind, access in (
        (0x607A, "target position", canopen.objectdictionary.INTEGER32, "rw"),
        (0x1018, "serial number", canopen.objectdictionary.UNSIGNED32, "ro"),
    ):
        variable = canopen.objectdictionary.ODVariable(name, index)
        variable.data_type, variable.access_type, variable.default = kind, access, 4711
        dictionary.add_object(variable)
    network = canopen.Network(can.Bus(interface="virtual", channel=channel))
    network.connect()
    node = network.create_node(5, dictionary)
    yield node
    network.disconnect()


def test_objects_are_read_and_written(channel: str, node: Any, tmp_path: Path) -> None:
    link = SdoLink(5, interface="virtual", channel=channel)
    with keep_transcript(tmp_path / "talk.txt"):
        link.download(0x607A, 0, (1234).to_bytes(4, "little", signed=True))
        assert int.from_bytes(link.upload(0x607A), "little") == 1234
        link.close()
    sent = [record.data for record in read_transcript(tmp_path / "talk.txt") if record.mark == ">"]
    assert sent[0] == b"605#237A6000D2040000"


def test_an_abort_says_why(channel: str, node: Any) -> None:
    link = SdoLink(5, interface="virtual", channel=channel)
    with pytest.raises(DeviceError, match="read only") as told:
        link.download(0x1018, 0, b"\1\0\0\0")
    assert told.value.effects == "none"
    with pytest.raises(DeviceError, match="does not exist"):
        link.upload(0x2000)
    link.close()


def test_a_node_that_is_off(channel: str, node: Any) -> None:
    link = SdoLink(6, interface="virtual", channel=channel)
    with pytest.raises(NoReply, match="node 6"):
        link.upload(0x1018, timeout_s=0.1)
    link.close()


def test_messages_of_others_are_no_answers(channel: str) -> None:
    link = CanLink(interface="virtual", channel=channel)
    with can.Bus(interface="virtual", channel=channel) as other:
        link.open()
        other.send(can.Message(arbitration_id=0x181, data=b"old", is_extended_id=False))

        def device() -> None:
            while (frame := other.recv(5)) is not None and frame.arbitration_id != 0x201:
                pass
            for number, data in ((0x700, b"\5"), (0x181, b"new")):
                other.send(can.Message(arbitration_id=number, data=data, is_extended_id=False))

        thread = threading.Thread(target=device, daemon=True)
        thread.start()
        answer = link.exchange(CanMessage(0x201, b"\1"), lambda message: message.id == 0x181, 2.0)
        assert answer.data == b"new"
        with pytest.raises(NoReply, match="201#01"):
            link.exchange(CanMessage(0x201, b"\1"), lambda message: message.id == 0x181, 0.1)
        thread.join(5)
    link.close()


def test_an_adapter_on_a_serial_port_and_its_end() -> None:
    end = PtyEnd()
    link = CanLink(interface="slcan", channel=end.address, bitrate=125000, sleep_after_open=0)

    def adapter() -> None:
        received = b""
        while b"t2011AB\r" not in received:
            received += end.read(0.02)
        end.write(b"t18127788\r")

    thread = threading.Thread(target=adapter, daemon=True)
    thread.start()
    answer = link.exchange(CanMessage(0x201, b"\xab"), lambda message: message.id == 0x181, 2.0)
    assert answer == CanMessage(0x181, b"\x77\x88")
    thread.join(5)
    end.unplug()
    with pytest.raises((LinkLost, NotConnected)):
        link.exchange(CanMessage(0x201, b"\xab"), lambda message: message.id == 0x181, 0.5)
    link.close()
    with pytest.raises(NotConnected, match="cannot be opened"):
        CanLink(interface="slcan", channel="/dev/nothing-there").open()


class Adapter:
    """An adapter on a serial port with one node behind it, whose answers are given in advance."""

    def __init__(self, answers: dict[bytes, bytes]) -> None:
        self.end, self._answers = PtyEnd(), answers
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        received = b""
        while not self._over.is_set():
            *lines, received = (received + self.end.read(0.02)).split(b"\r")
            for line in lines:
                self.end.write(self._answers.get(line, b""))

    def close(self) -> None:
        self._over.set()
        self._thread.join(5)
        self.end.close()


ASKED_6041 = b"t60584041600000000000"
STATUS = b"t58584B41600027020000\r"


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    adapter = Adapter({ASKED_6041: STATUS})
    yield adapter
    adapter.close()


def at(adapter: Adapter, **more: Any) -> SdoLink:
    port = {"interface": "slcan", "channel": adapter.end.address, "sleep_after_open": 0, "timeout": 0.02}
    return SdoLink(5, late_s=0.05, **port, **more)


def test_emergencies_are_told(adapter: Adapter) -> None:
    adapter._answers[ASKED_6041] = b"t08581186010000000000\r" + STATUS
    received: list[bytes] = []
    link = at(adapter, emergency=received.append)
    assert link.upload(0x6041) == b"\x27\x02"
    assert received == [b"\x11\x86\x01\0\0\0\0\0"]
    link.close()


def test_noise_from_the_adapter_ends_the_connection(adapter: Adapter) -> None:
    adapter._answers[ASKED_6041] = b"t5?\x1f84B416000\r"
    link = at(adapter)
    with pytest.raises(LinkLost, match="receives nothing any more"):
        link.upload(0x6041, timeout_s=0.2)
    adapter._answers[ASKED_6041] = STATUS
    assert link.upload(0x6041) == b"\x27\x02"
    link.close()


def test_a_node_says_who_it_is_whenever_the_link_is_opened(adapter: Adapter) -> None:
    adapter._answers[ASKED_6041] = STATUS
    asked = []

    def identify(link: SdoLink) -> str:
        asked.append(link.upload(0x6041))
        return "a drive"

    link = at(adapter, identify=identify, expected="a drive")
    link.open()
    link.close()
    link.open()
    assert len(asked) == 2
    link.close()
    other = at(adapter, identify=identify, expected="a valve")
    with pytest.raises(WrongDevice, match="a valve was expected, but a drive answers"):
        other.open()
    adapter._answers[ASKED_6041] = b""
    with pytest.raises(NotConnected, match="does not identify itself"):
        at(adapter, identify=lambda link: str(link.upload(0x6041, timeout_s=0.1))).open()
