"""Serial ports (pseudo-terminals) and TCP: what goes wrong is named, and no wrong answer is believed."""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.errors import (
    DeviceError,
    Garbled,
    HalfReply,
    LinkError,
    LinkLost,
    NoReply,
    NotConnected,
    StrayReply,
    WrongDevice,
)
from labos.link import (
    Checked,
    FarEnd,
    LengthPrefixed,
    Link,
    OffScript,
    PtyEnd,
    ScriptedWire,
    SerialWire,
    TcpEnd,
    TcpWire,
    Terminated,
    Wire,
    keep_transcript,
    read_transcript,
    replay,
)
from tests.integration.link.far import answer_on


def names_its_question(question: bytes, answer: bytes) -> bool:
    return answer.split(b" ")[0] == question.split(b" ")[0]


def ask_who(link: Link) -> str:
    return link.exchange(b"WHO", 0.4).decode()


@pytest.fixture(params=["pty", "tcp", "serial over tcp"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def end(kind: str, tmp_path: Path) -> Iterator[FarEnd]:
    end: FarEnd = PtyEnd(tmp_path / "port") if kind == "pty" else TcpEnd()
    yield end
    end.close()


@pytest.fixture
def wire(kind: str, end: FarEnd) -> Wire:
    if kind == "tcp":
        assert isinstance(end, TcpEnd)
        return TcpWire(end.host, end.port)
    return SerialWire(end.address)


@pytest.fixture
def link(wire: Wire) -> Iterator[Link]:
    link = Link(wire, Terminated(), late_s=0.2)
    yield link
    link.close()


def test_asks_and_hears(link: Link, end: FarEnd) -> None:
    with answer_on(end, {b"T?": b"T 22.5\r\n", b"H?": b"H 40\r\n"}) as device:
        assert link.exchange(b"T?") == b"T 22.5"
        assert link.exchange(b"H?") == b"H 40"
        assert device.received == [b"T?", b"H?"]


def test_silence_is_no_reply_and_takes_no_longer_than_allowed(link: Link, end: FarEnd) -> None:
    with answer_on(end, {}):
        link.open()
        began = time.monotonic()
        with pytest.raises(NoReply, match="does not answer") as told:
            link.exchange(b"T?", 0.15)
        assert time.monotonic() - began < 0.6
        assert told.value.effects == "unknown"


def test_half_a_reply_is_no_reply_and_spoils_no_other(link: Link, end: FarEnd) -> None:
    with answer_on(end, {b"A": b"A on", b"B": b"B off\r\n"}):
        with pytest.raises(HalfReply, match="A on"):
            link.exchange(b"A", 0.15)
        assert link.exchange(b"B") == b"B off"


def test_a_late_answer_is_not_taken_for_the_next_one(link: Link, end: FarEnd) -> None:
    def late() -> None:
        threading.Timer(0.2, end.write, [b"door open\r\n"]).start()

    with answer_on(end, {b"door?": late, b"lid?": b"lid closed\r\n"}):
        with pytest.raises(NoReply):
            link.exchange(b"door?", 0.1)
        assert link.exchange(b"lid?") == b"lid closed"


def test_answers_that_name_their_question_are_told_apart(wire: Wire, end: FarEnd) -> None:
    link = Link(wire, Terminated(), answers=names_its_question)
    with answer_on(end, {b"A 1": b"B 2\r\nA ok\r\n", b"C 1": b"A ok\r\n"}):
        assert link.exchange(b"A 1") == b"A ok"
        with pytest.raises(StrayReply, match="no answer to b'C 1'"):
            link.exchange(b"C 1", 0.15)
    link.close()


def test_garbage_is_told_from_a_message(wire: Wire, end: FarEnd) -> None:
    framing = Checked(Terminated(), lambda message: b"%02X" % (sum(message) % 256), 2)
    link = Link(wire, framing, late_s=0.1)
    good, bad = b"on%02X" % (sum(b"on") % 256), b"of%02X" % (sum(b"on") % 256)
    with answer_on(end, {framing.pack(b"A")[:-2]: good + b"\r\n", framing.pack(b"B")[:-2]: bad + b"\r\n"}):
        assert link.exchange(b"A") == b"on"
        with pytest.raises(Garbled, match="check sum"):
            link.exchange(b"B")
        assert link.exchange(b"A") == b"on"
    link.close()


def test_unplugged_in_mid_exchange(link: Link, end: FarEnd) -> None:
    with answer_on(end, {b"T?": end.unplug}):
        with pytest.raises(LinkLost) as told:
            link.exchange(b"T?", 2.0)
        assert told.value.effects == "unknown"
        assert not link.is_open


def test_comes_back_by_itself_and_does_not_hammer(link: Link, end: FarEnd) -> None:
    with answer_on(end, {b"T?": b"T 22.5\r\n"}) as device:
        assert link.exchange(b"T?") == b"T 22.5"
        end.unplug()
        with pytest.raises(LinkError):
            link.exchange(b"T?", 0.2)
        link.close()
        with pytest.raises(NotConnected) as told:
            link.exchange(b"T?", 0.2)
        assert told.value.effects == "none"
        with pytest.raises(NotConnected, match="next try is in"):
            link.exchange(b"T?", 0.2)
        end.plug()
        link.open(patience_s=5)
        assert link.exchange(b"T?") == b"T 22.5"
        assert device.received == [b"T?", b"T?"]


def test_another_device_at_the_same_address(wire: Wire, end: FarEnd) -> None:
    link = Link(wire, Terminated(), identify=ask_who)
    with answer_on(end, {b"WHO": b"sealer 17\r\n", b"GO": b"gone\r\n"}) as device:
        assert link.exchange(b"GO") == b"gone"
        end.unplug()
        link.close()
        device.script[b"WHO"] = b"peeler 4\r\n"
        end.plug()
        with pytest.raises(WrongDevice, match="sealer 17 was expected, but peeler 4 answers") as told:
            link.open(patience_s=5)
        assert told.value.effects == "none"
        assert device.received == [b"WHO", b"GO", b"WHO"]
    link.close()


def test_who_does_not_say_who_it_is_is_not_asked_anything(wire: Wire, end: FarEnd) -> None:
    link = Link(wire, Terminated(), identify=ask_who, expected="sealer 17")
    with (
        answer_on(end, {b"WHO": b"seal"}) as device,
        pytest.raises(NotConnected, match="does not identify itself"),
    ):
        link.exchange(b"GO")
    assert device.received == [b"WHO"]


def test_every_error_of_a_wire_is_one_of_the_device() -> None:
    for kind in (NotConnected, WrongDevice, LinkLost, NoReply, HalfReply, Garbled, StrayReply):
        assert issubclass(kind, LinkError)
        assert issubclass(kind, DeviceError)
    assert not issubclass(NoReply, NotConnected)


def test_a_port_is_used_by_one_program_only(tmp_path: Path) -> None:
    end = PtyEnd()
    first, second = SerialWire(end.address), SerialWire(end.address)
    first.open()
    with pytest.raises(NotConnected, match="no other program"):
        second.open()
    first.close()
    second.open()
    second.close()
    end.close()


def test_messages_with_a_length_may_hold_anything(tmp_path: Path) -> None:
    end = TcpEnd()
    link = Link(TcpWire(end.host, end.port), LengthPrefixed(2))
    whole = bytes(range(256)) * 3
    with answer_on(end, {}, stop=b"?") as device:
        packed = LengthPrefixed(2).pack(whole)
        device.script[b"\0\2a"] = lambda: (end.write(packed[:100]), end.write(packed[100:]))  # type: ignore[func-returns-value]
        assert link.exchange(b"a?") == whole
    link.close()


def test_a_transcript_holds_every_byte_and_replays(link: Link, end: FarEnd, tmp_path: Path) -> None:
    path = tmp_path / "talk.txt"
    with keep_transcript(path), answer_on(end, {b"A\t": b"\\ \x00\xff\r\n", b"B": b"no end"}):
        assert link.exchange(b"A\t") == b"\\ \x00\xff"
        with pytest.raises(HalfReply):
            link.exchange(b"B", 0.1)
        link.close()
    records = read_transcript(path)
    assert {record.link for record in records} == {link.name}
    assert b"".join(record.data for record in records if record.mark == ">") == b"A\t\r\nB\r\n"

    script = ScriptedWire(path)
    again = Link(script, Terminated())
    assert again.exchange(b"A\t") == b"\\ \x00\xff"
    with pytest.raises(OffScript, match="the transcript has"):
        again.exchange(b"C")
    with pytest.raises(HalfReply):
        Link(ScriptedWire([r for r in records if r.at_s > records[2].at_s]), Terminated()).exchange(b"B")
    assert not script.is_over


def test_a_transcript_replays_over_a_real_wire(link: Link, end: FarEnd, tmp_path: Path) -> None:
    path = tmp_path / "talk.txt"
    with keep_transcript(path), answer_on(end, {b"A": b"1\r\n", b"B": b"2\r\n"}):
        assert [link.exchange(b"A"), link.exchange(b"B")] == [b"1", b"2"]
        link.close()
    stage = PtyEnd()
    left: list[object] = []
    actor = threading.Thread(target=lambda: left.extend(replay(path, stage)))
    actor.start()
    again = Link(SerialWire(stage.address), Terminated())
    assert [again.exchange(b"A"), again.exchange(b"B")] == [b"1", b"2"]
    actor.join(5)
    assert left == []
    again.close()
    stage.close()


def test_a_line_that_is_unplugged_while_its_end_waits_reads_no_other_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The number of the closed file may be given to another one at once; its read might never return."""
    end = PtyEnd()
    number, opened = end._far, list[int]()

    def unplug_meanwhile(waiting: list[int], *_: object) -> tuple[list[int], list[int], list[int]]:
        end.unplug()
        while number not in opened:
            into, out = os.pipe()
            opened.extend((into, out))
            os.write(out, b"not of this line")
        return waiting, [], []

    try:
        with monkeypatch.context() as patched:
            patched.setattr(select, "select", unplug_meanwhile)
            assert end.read(1.0) == b""
    finally:
        end.close()
        for each in opened:
            os.close(each)
