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

from labos.errors import DeviceError, LinkLost, NoReply, NotConnected
from labos.link import CanLink, CanMessage, PtyEnd, SdoLink, read_transcript, recording

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
    with recording(tmp_path / "talk.txt"):
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
        heard = b""
        while b"t2011AB\r" not in heard:
            heard += end.read(0.02)
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
