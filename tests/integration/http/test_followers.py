"""Many follow the log, and nobody is held up: neither the kernel nor those who read quickly."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.client._lab import API
from labos.core.envelope import Envelope, Record
from labos.http import tail as tails
from labos.http.shared import Shared
from labos.http.tail import StreamFilter, Tail
from labos.ports import LogQuery
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.support.lab_process import until

FLOW = {"text": "labos: 1\nname: f\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def client(lab: LabThread) -> Iterator[LabClient]:
    with LabClient(lab.url) as found:
        yield found


@pytest.fixture
def raw(lab: LabThread) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=lab.url + API, timeout=30) as found:
        yield found


def read_followed(lines: Iterator[str], count: int) -> list[dict[str, Any]]:
    """The next so many events of a stream."""
    found: list[dict[str, Any]] = []
    for line in lines:
        if line.startswith("data: "):
            found.append(json.loads(line.removeprefix("data: ")))
        if len(found) == count:
            break
    return found


def some_events(client: LabClient) -> int:
    """Events of several types and streams; returns the position before them."""
    before = int(client.health()["position"])
    for user in ("ada", "bo"):
        run = client.submit(FLOW, user=user)
        client.pause(run, user)
        client.cancel(run, user)
    return before


def test_what_is_followed_is_what_is_paged(raw: httpx.Client, client: LabClient) -> None:
    before = some_events(client)
    paged = [event["position"] for event in client.events(before)]
    assert len(paged) > 5
    for _ in range(2):  # first from the log, then as it comes
        with raw.stream("GET", "/events/stream", params={"after": before}) as stream:
            assert "text/event-stream" in stream.headers["content-type"]
            assert [e["position"] for e in read_followed(stream.iter_lines(), len(paged))] == paged
    with raw.stream("GET", "/events/stream", params={"after": 2**63 - 1, "type": "run"}) as stream:
        assert stream.status_code == 200


@pytest.mark.parametrize(
    "asked",
    [
        {"type": "run"},
        {"type": "run.*"},
        {"type": "run.submitted"},
        {"type": ["run.paused", "plan"]},
        {"actor": "ada"},
        {"mentions": "bo"},
        {"mentions": 'f"'},
        {"mentions": "%"},
        {"actor": "bo", "type": "run"},
    ],
)
def test_a_filter_means_the_same_everywhere(
    raw: httpx.Client, client: LabClient, asked: dict[str, Any]
) -> None:
    raw.get("/events", params={"wait": 0})  # from now on what comes is kept
    before = some_events(client)
    kept = raw.get("/events", params={"after": before, **asked}).json()["events"]
    read = raw.get("/events", params={"after": 0, **asked}).json()["events"]
    assert [e for e in read if e["position"] > before] == kept
    if asked.get("mentions") not in ('f"', "%"):
        assert kept


def test_a_follower_goes_on_where_it_was(raw: httpx.Client, client: LabClient) -> None:
    before = some_events(client)
    with raw.stream("GET", "/events/stream", params={"after": before}) as stream:
        first = read_followed(stream.iter_lines(), 3)
    known = {"last-event-id": str(first[-1]["position"])}
    with raw.stream("GET", "/events/stream", params={"after": before}, headers=known) as stream:
        (then,) = read_followed(stream.iter_lines(), 1)
    assert then["position"] == first[-1]["position"] + 1


def test_a_browser_that_comes_again_goes_on_where_it_was(raw: httpx.Client, client: LabClient) -> None:
    """It sends the ``after`` of the first time with the ``id`` that it has seen last, whichever is larger."""
    before = some_events(client)
    paged = [event["position"] for event in client.events(before)]
    for after in (0, before, paged[3]):
        known = {"last-event-id": str(paged[1])}
        with raw.stream("GET", "/events/stream", params={"after": after}, headers=known) as stream:
            assert [e["position"] for e in read_followed(stream.iter_lines(), 2)] == paged[2:4]


def test_nothing_keeps_a_stream_back(raw: httpx.Client, lab: LabThread, client: LabClient) -> None:
    """In the process for followers, and in the kernel's where there is none."""
    before = some_events(client)
    service = lab.runtime.service
    viewers = service.viewers
    try:
        for service.viewers in (viewers, None):
            with raw.stream("GET", "/events/stream", params={"after": before}) as stream:
                assert stream.headers["cache-control"] == "no-store"
                assert stream.headers["x-accel-buffering"] == "no"
                assert stream.headers["content-type"] == "text/event-stream; charset=utf-8"
                lines = stream.iter_lines()
                assert next(lines).startswith("retry: ")
                assert read_followed(lines, 1)[0]["position"] == before + 1
    finally:
        service.viewers = viewers


def test_followers_outlive_their_process(lab: LabThread, raw: httpx.Client, client: LabClient) -> None:
    before = some_events(client)
    with raw.stream("GET", "/events/stream", params={"after": before}) as stream:
        read_followed(stream.iter_lines(), 1)
        viewers = lab.runtime.service.viewers
        assert viewers is not None
        assert viewers._process is not None
        pid = viewers._process.pid
        assert str(lab.settings.database) not in Path(f"/proc/{pid}/cmdline").read_text()
        os.kill(pid, signal.SIGKILL)
    until(lambda: viewers._process is None, "its end is seen")
    with raw.stream("GET", "/events/stream", params={"after": before}) as stream:
        assert read_followed(stream.iter_lines(), 1)
    assert client.health()["status"] == "ok"


def test_one_who_only_waits_hears_of_the_next_event(raw: httpx.Client, client: LabClient) -> None:
    after = client.health()["position"]
    found: list[httpx.Response] = []

    def ask() -> None:
        found.append(raw.get("/events", params={"after": after, "wait": 20}))

    waiting = threading.Thread(target=ask)
    waiting.start()
    some_events(client)
    waiting.join()
    assert found[0].json()["events"]


# -- the tail by itself ------------------------------------------------------------------------------


def record(position: int, kind: str = "run.submitted", payload: bytes = b"{}") -> Record:
    head = Envelope("lab", position, f"id{position}", "R1", 1, kind, 1, 0, "ada", "R1", "", "")
    return Record(head, b"", payload, b"")


class Known:
    """A log of records that are there already."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.read = 0

    def select(self, query: LogQuery) -> Iterator[Record]:
        self.read += 1
        upto = len(self.records) if query.upto is None else query.upto
        yield from self.records[query.after : upto]


def grow(log: Known, tail: Tail, count: int, payload: bytes = b"{}") -> None:
    new = [record(len(log.records) + n + 1, payload=payload) for n in range(count)]
    log.records += new
    tail.add(new)


def ids(pieces: Sequence[bytes]) -> list[int]:
    lines = b"".join(pieces).decode().splitlines()
    return [int(line.removeprefix("id: ")) for line in lines if line.startswith("id: ")]


def test_what_is_new_is_read_by_nobody_and_encoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    encoded: list[int] = []
    line = tails._make_line
    monkeypatch.setattr(tails, "_make_line", lambda r: encoded.append(r.head.position) or line(r))  # type: ignore[func-returns-value]

    async def go() -> None:
        log = Known()
        tail = Tail(log, lambda: len(log.records))  # type: ignore[arg-type]
        streams = [tail.follow(LogQuery()) for _ in range(50)]
        waiting = [asyncio.ensure_future(anext(stream)) for stream in streams]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        grow(log, tail, 10)
        pieces = await asyncio.gather(*waiting)
        assert {tuple(ids([piece])) for piece in pieces} == {tuple(range(1, 11))}
        assert log.read == 0
        tail.close()

    asyncio.run(go())
    assert encoded == list(range(1, 11))


def test_one_who_takes_nothing_up_is_dropped_and_told_from_where_to_go_on() -> None:
    async def go() -> None:
        log = Known()
        tail = Tail(log, lambda: len(log.records))  # type: ignore[arg-type]
        slow, quick = tail.follow(LogQuery()), tail.follow(LogQuery())
        first = asyncio.ensure_future(anext(slow))
        seen: list[bytes] = []
        more = asyncio.Event()

        async def read() -> None:
            async for piece in quick:
                seen.append(piece)
                more.set()

        reading = asyncio.ensure_future(read())
        grow(log, tail, 1)
        got = [await first]
        second = asyncio.ensure_future(anext(slow))
        await asyncio.sleep(0)
        grow(log, tail, 1)
        got.append(await second)  # it follows, and stops reading here
        total = 2
        while len(log.records) * 10_000 < 3 * tails.LARGEST_BACKLOG:
            grow(log, tail, 10, b'"' + b"x" * 10_000 + b'"')
            total = len(log.records)
            while not ids(seen) or ids(seen)[-1] < total:
                more.clear()
                await more.wait()
        got += [piece async for piece in slow]  # it ends by itself
        assert sum(map(len, got)) < 1.2 * tails.LARGEST_BACKLOG
        last = got[-1].decode()
        assert "event: dropped" in last
        told = json.loads(last.split("data: ")[1])
        assert told["after"] == ids(got)[-1]
        assert ids(got)[:-1] == list(range(1, told["after"] + 1))
        again = tail.follow(LogQuery(after=told["after"]))
        rest: list[bytes] = []
        async for piece in again:
            rest.append(piece)
            if ids(rest)[-1] == total:
                break
        assert ids(rest) == list(range(told["after"] + 1, total + 1))
        assert ids(seen) == list(range(1, total + 1))
        tail.close()
        await reading

    asyncio.run(asyncio.wait_for(go(), 60))


def test_nothing_is_left_out_when_the_log_was_read_again() -> None:
    async def go() -> None:
        log = Known()
        tail = Tail(log, lambda: len(log.records))  # type: ignore[arg-type]
        stream = tail.follow(LogQuery())
        first = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        grow(log, tail, 2)
        seen = [await first]
        # What was written before the kernel lost its database, and of which nobody told.
        log.records += [record(3), record(4)]
        tail.on_reopened()
        grow(log, tail, 1)
        while ids(seen)[-1] < 5:
            seen.append(await anext(stream))
        assert ids(seen) == [1, 2, 3, 4, 5]
        tail.close()

    asyncio.run(asyncio.wait_for(go(), 30))


def test_a_page_of_large_events_is_short() -> None:
    async def go() -> None:
        log = Known()
        tail = Tail(log, lambda: len(log.records))  # type: ignore[arg-type]
        log.records += [record(n + 1, payload=b'"' + b"x" * 60_000 + b'"') for n in range(500)]
        after, found = 0, 0
        while after < 500:
            page = await tail.read_page(LogQuery(after=after))
            assert len(page) < tails.PAGE_BYTES + 100_000
            told = json.loads(page)
            after, found = told["position"], found + len(told["events"])
        assert found == 500

    asyncio.run(go())


def test_what_is_kept_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tails, "KEPT", 100_000)

    async def go() -> None:
        log = Known()
        tail = Tail(log, lambda: len(log.records))  # type: ignore[arg-type]
        await tail.read_page(LogQuery())
        for _ in range(100):
            grow(log, tail, 10, b'"' + b"x" * 500 + b'"')
        assert tail._size <= 100_000
        assert tail._begin > 500
        page = json.loads(await tail.read_page(LogQuery(after=tail._begin - 5)))
        assert page["events"][0]["position"] == tail._begin - 4
        assert page["position"] == 1000

    asyncio.run(go())


def test_a_filter_without_words_takes_everything() -> None:
    line = tails._make_line(record(1))
    assert StreamFilter().takes(line)
    assert not StreamFilter(types=("action",)).takes(line)


# -- answers for many --------------------------------------------------------------------------------


def test_many_who_ask_for_the_state_share_the_work() -> None:
    worked: list[float] = []

    def work() -> bytes:
        worked.append(time.monotonic())
        time.sleep(0.01)
        return str(len(worked)).encode()

    async def flush() -> None:
        await asyncio.sleep(0)

    async def go() -> None:
        shared = Shared(work, flush)
        found = await asyncio.gather(*(shared.get() for _ in range(100)))
        assert set(found) == {b"1"}
        began = time.monotonic()
        while time.monotonic() - began < 0.5:
            asked = len(worked)
            answer = await shared.get()
            assert int(answer) > asked  # never older than the question
        assert len(worked) * 0.01 < 0.5 * 0.4

    asyncio.run(go())
