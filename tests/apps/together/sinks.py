"""Events are carried into a file of JSON lines and into a topic of Kafka while they happen."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labos.core.envelope import Record
from tests.support.kafka import KafkaBroker
from tests.support.lab_process import until

TOPIC = "lab"
PATIENCE_S = 240.0


class Sink:
    """`labos export events --to TARGET --follow` as a process."""

    def __init__(self, home: Path, target: str, log: Path) -> None:
        self._home, self.target, self._log = home, target, log
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        words = ("export", "events", "--to", self.target, "--follow", "--home", str(self._home))
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "labos", *words], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def kill(self) -> None:
        """kill -9."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def read_log(self) -> str:
        return self._log.read_text("utf-8", "replace")[-2000:]


class Sinks:
    """Both sinks of a lab; without a broker, the file only."""

    def __init__(self, home: Path, folder: Path, *, kafka: bool) -> None:
        self.file = folder / "events.jsonl"
        self.broker = KafkaBroker(folder / "broker") if kafka else None
        self._home, self._folder = home, folder
        self.sinks: list[Sink] = []

    def start(self) -> None:
        """The lab has begun already: its log is there."""
        if self.broker is not None:
            self.broker.start()
            target = f"kafka://{self.broker.address}/{TOPIC}"
            self.sinks.append(Sink(self._home, target, self._folder / "kafka-sink.log"))
        self.sinks.append(Sink(self._home, str(self.file), self._folder / "file-sink.log"))
        for sink in self.sinks:
            sink.start()

    def close(self) -> None:
        for sink in self.sinks:
            sink.kill()
        if self.broker is not None:
            self.broker.kill()

    def in_file(self) -> list[dict[str, Any]]:
        """What stands in the file; a line that is being written is none yet."""
        if not self.file.exists():
            return []
        return [json.loads(line) for line in self.file.read_bytes().split(b"\n")[:-1]]

    def in_topic(self) -> list[dict[str, Any]]:
        return self.broker.values(TOPIC) if self.broker is not None else []

    def check(self, records: Sequence[Record]) -> dict[str, int]:
        """Wait until both hold the last event, and compare them with the log: nothing is missing and nothing
        out of order. Returns how many events each holds twice."""
        last = records[-1].head.position
        until(
            lambda: _last(self.in_file()) >= last,
            f"the file's last event: {self.sinks[-1].read_log()}",
            PATIENCE_S,
        )
        found = {"file": self.in_file()}
        if self.broker is not None:
            until(
                lambda: _last(self.in_topic()) >= last,
                f"the topic's last event: {self.sinks[0].read_log()}",
                PATIENCE_S,
            )
            found["topic"] = self.in_topic()
        return {name: twice(name, events, records) for name, events in found.items()}


def twice(name: str, events: Sequence[dict[str, Any]], records: Sequence[Record]) -> int:
    """How many events come again. Raises AssertionError unless the first of each stand in the order of the
    log, each with its hash, and each that comes again is the same."""
    firsts: dict[int, object] = {}
    again = 0
    for event in events:
        position = int(str(event["position"]))
        again += position in firsts
        assert firsts.setdefault(position, event["hash"]) == event["hash"], f"{name}: {position} differs"
    expected = {record.head.position: record.hash.hex() for record in records}
    got = [position for position in firsts if position <= records[-1].head.position]
    assert got == list(expected), f"{name}: {_first_gap(got)}"
    assert all(firsts[position] == told for position, told in expected.items()), f"{name}: other hashes"
    return again


def _first_gap(positions: Sequence[int]) -> str:
    for number, position in enumerate(positions, 1):
        if position != number:
            return f"position {position} stands where {number} should be"
    return f"ends at {len(positions)}"


def _last(events: Sequence[dict[str, Any]]) -> int:
    return int(str(events[-1]["position"])) if events else 0
