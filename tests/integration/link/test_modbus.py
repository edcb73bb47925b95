"""Modbus against pymodbus' own server, over TCP and over a serial line; and against misbehaviour."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator

import pytest
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from labos.errors import DeviceError, Garbled, HalfReply, LinkLost, NoReply, NotConnected, StrayReply
from labos.link import ModbusLink, PtyEnd, TcpEnd, keep_transcript, read_transcript
from labos.link.modbus import crc16
from labos.settings import free_port


def unit() -> SimDevice:
    return SimDevice(
        id=3,
        simdata=(
            [SimData(0, values=[False] * 32, datatype=DataType.BITS)],
            [SimData(0, values=[True] * 32, datatype=DataType.BITS)],
            [SimData(10, values=[7, 8, 9, 65535], datatype=DataType.REGISTERS)],
            [SimData(0, values=[225, 400], datatype=DataType.REGISTERS)],
        ),
    )


class Bridge:
    """Two pseudo-terminals, joined as by a null-modem cable."""

    def __init__(self) -> None:
        self.ends = PtyEnd(), PtyEnd()
        self._over = threading.Event()
        self._threads = [
            threading.Thread(target=self._copy, args=pair, daemon=True)
            for pair in (self.ends, self.ends[::-1])
        ]
        for thread in self._threads:
            thread.start()

    def _copy(self, one: PtyEnd, other: PtyEnd) -> None:
        while not self._over.is_set():
            if data := one.read(0.02):
                other.write(data)

    def close(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join(5)
        for end in self.ends:
            end.close()


@pytest.fixture(params=["tcp", "rtu"])
def link(request: pytest.FixtureRequest) -> Iterator[ModbusLink]:
    loop = asyncio.new_event_loop()
    bridge = Bridge() if request.param == "rtu" else None
    port = free_port()

    async def serve() -> ModbusTcpServer | ModbusSerialServer:
        server: ModbusTcpServer | ModbusSerialServer
        if bridge is not None:
            server = ModbusSerialServer(unit(), port=bridge.ends[0].address, baudrate=19200)
        else:
            server = ModbusTcpServer(unit(), address=("127.0.0.1", port))
        await server.serve_forever(background=True)
        return server

    server = loop.run_until_complete(serve())
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    if bridge is not None:
        link = ModbusLink.rtu(bridge.ends[1].address, unit=3, parity="N", late_s=0.1)
    else:
        link = ModbusLink.tcp("127.0.0.1", port, unit=3)
    yield link
    link.close()
    asyncio.run_coroutine_threadsafe(server.shutdown(), loop).result(5)
    loop.call_soon_threadsafe(loop.stop)
    thread.join(5)
    loop.close()
    if bridge is not None:
        bridge.close()


def test_reads_and_writes(link: ModbusLink) -> None:
    assert link.holding(10, 4) == [7, 8, 9, 65535]
    link.write_holding(11, [500, 0])
    assert link.holding(10, 4) == [7, 500, 0, 65535]
    assert link.inputs(0, 2) == [225, 400]
    assert link.coils(0, 3) == [False] * 3
    link.write_coils(1, [True])
    assert link.coils(0, 3) == [False, True, False]
    assert link.discretes(0, 10) == [True] * 10


def test_a_refusal_says_what_was_refused(link: ModbusLink) -> None:
    with pytest.raises(DeviceError, match=r"no such address \(Modbus exception 2") as told:
        link.holding(900)
    assert told.value.effects == "none"
    assert link.holding(10) == [7]


def reply(number: int, body: bytes, unit: int = 3) -> bytes:
    return number.to_bytes(2, "big") + b"\0\0" + (len(body) + 1).to_bytes(2, "big") + bytes([unit]) + body


def test_an_answer_to_an_earlier_question_is_not_believed() -> None:
    end = TcpEnd()
    link = ModbusLink.tcp("127.0.0.1", end.port, unit=3)
    asked = []

    def device() -> None:
        while len(asked) < 3:
            if data := end.read(0.02):
                asked.append(data)
                if len(asked) == 2:  # first what was asked before, then what is asked now
                    end.write(reply(1, b"\x03\x02\x00\x01") + reply(2, b"\x03\x02\x00\x02"))
                if len(asked) == 3:
                    end.write(reply(2, b"\x03\x02\x00\x02"))

    thread = threading.Thread(target=device, daemon=True)
    thread.start()
    with pytest.raises(NoReply):
        link.holding(0, timeout_s=0.1)
    assert link.holding(1, timeout_s=2) == [2]
    with pytest.raises(StrayReply):
        link.holding(2, timeout_s=0.1)
    thread.join(5)
    link.close()
    end.close()


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (b"\x03\x03\x02\x00\x07\xff\xff", Garbled),
        (b"\x03\x03\x02\x00", HalfReply),
        (b"\x04\x03\x02\x00\x07" + crc16(b"\x04\x03\x02\x00\x07"), Garbled),
        (b"\x03\x04\x02\x00\x07" + crc16(b"\x03\x04\x02\x00\x07"), Garbled),
        (b"\x03\x03\x04\x00\x07\x00\x08" + crc16(b"\x03\x03\x04\x00\x07\x00\x08"), Garbled),
        (b"", NoReply),
    ],
    ids=["check sum", "half", "other unit", "other function", "too much", "silence"],
)
def test_what_comes_over_a_serial_line_is_checked(answer: bytes, kind: type[Exception]) -> None:
    end = PtyEnd()
    link = ModbusLink.rtu(end.address, unit=3, parity="N", late_s=0.05)

    def device() -> None:
        while not end.read(0.02):
            pass
        end.write(answer)

    thread = threading.Thread(target=device, daemon=True)
    thread.start()
    with pytest.raises(kind) as told:
        link.holding(0, timeout_s=0.2)
    assert type(told.value) is kind
    thread.join(5)
    end.unplug()
    with pytest.raises((LinkLost, NotConnected)):
        link.holding(0, timeout_s=0.2)
    link.close()


def test_bytes_are_traced(link: ModbusLink, tmp_path: object) -> None:
    path = f"{tmp_path}/talk.txt"
    with keep_transcript(path):
        link.inputs(0, 2)
    marks = [(record.mark, record.data) for record in read_transcript(path) if record.mark in "<>"]
    assert marks[0][0] == ">"
    assert b"\x03\x04\x00\x00\x00\x02" in marks[0][1]
    assert b"\x03\x04\x04\x00\xe1\x01\x90" in b"".join(data for mark, data in marks if mark == "<")
