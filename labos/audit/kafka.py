"""Exports events to a topic of Kafka: in order, each at least once. A message is a CloudEvent in structured
mode, as in the protocol binding of CloudEvents for Kafka. All messages go to partition 0 of the topic, so
that they stay in order. The export continues after the last event in the topic, so that a broker which lost
events gets them again. The position beside the log is used if the topic's messages have expired. Readers
recognise repeated events by their `position`.
"""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from labos.audit.cloudevents import encode_cloudevent, source_of
from labos.core.envelope import Record
from labos.errors import BadInput, SystemFailed
from labos.lockfile import FileLock
from labos.private import make_folder, replace_file

if TYPE_CHECKING:
    from confluent_kafka import KafkaError, Message

SCHEME = "kafka://"
HEADERS = [("content-type", b"application/cloudevents+json; charset=UTF-8")]
PARTITION = 0
LOOKED_BACK = 1000
"""The number of last messages of the topic in which an event of this lab is searched."""
WAIT_S = 1.0
"""The time between two checks whether messages have arrived."""

OURS = {
    "acks": "all",
    "enable.idempotence": True,
    "enable.gapless.guarantee": True,  # an error is better than a message that is left out
    "message.timeout.ms": 0,  # no limit of the library: how long we wait is set here
}
"""Settings for order and completeness, which a file of settings cannot change."""

_URL = re.compile(r"kafka://([^/?#]+)/([A-Za-z0-9._-]{1,249})")
_SETTING = re.compile(r"\s*([a-z][a-z0-9._-]*)\s*=\s*(.*?)\s*")

Report = Callable[[str], None]


class Stored(msgspec.Struct, frozen=True):
    """The data stored beside the log: the position up to which this topic has the events of this lab."""

    topic: str
    source: str
    position: int


class KafkaTopic(msgspec.Struct, frozen=True):
    brokers: str
    name: str

    @classmethod
    def parse(cls, url: str) -> KafkaTopic:
        """``kafka://broker:9092,other:9092/topic``. Raises BadInput."""
        found = _URL.fullmatch(url)
        if found is None or "@" in found[1]:
            raise BadInput(
                f"{url.rpartition('@')[2]!r} does not name a Kafka topic.",
                remedy="Write kafka://BROKER:9092/TOPIC; put passwords into the file of --settings.",
            )
        return cls(found[1], found[2])


def read_settings(path: Path) -> dict[str, str]:
    """Read a file of settings of librdkafka, with ``name=value`` on each line. Raises BadInput."""
    settings: dict[str, str] = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path} cannot be read: {error}.", remedy="Name a text file.") from None
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        found = _SETTING.fullmatch(line)
        if found is None:
            raise BadInput(f"{path}:{number}: this line is not a setting.", remedy="Write it as name=value.")
        if found[1] in OURS:
            raise BadInput(
                f"{path}:{number}: LabOS itself sets {found[1]}, to lose no event.",
                remedy="Leave that line out.",
            )
        settings[found[1]] = found[2]
    return settings


class _ProducerFailed(Exception):
    """The producer cannot continue without a gap."""


class KafkaSink:
    """The topic, at the position up to which it has the lab's events. ``patience_s`` is how long a broker may
    be unreachable (None: without limit); ``report`` is called once when it is unreachable and once when it is
    back."""

    def __init__(
        self,
        topic: KafkaTopic,
        lab: str,
        file: Path,
        settings: Mapping[str, str],
        *,
        patience_s: float | None = None,
        report: Report = lambda words: None,
    ) -> None:
        """Raises BadInput for settings that the client library refuses, and while another process carries
        events to this topic; SystemFailed for a broker that does not answer in time."""
        _need_library()
        self._topic, self._file, self._report = topic, file, report
        self._source = source_of(lab)
        self._lab = lab.encode()
        self._settings = {
            "bootstrap.servers": topic.brokers,
            "client.id": "labos",
            "reconnect.backoff.max.ms": 2000,
            **settings,
        }
        self._patience_s = patience_s
        self._is_away = False
        self._failure = ""
        self._begun_anew_at = -1
        self._log = logging.getLogger("labos.kafka")
        self._log.addHandler(logging.NullHandler())
        self._log.propagate = False
        self._producer: Any = None
        make_folder(file.parent)
        self._lock = FileLock(file.with_suffix(".lock"))
        if not self._lock.acquire(f"process {os.getpid()}"):
            raise BadInput(
                f"Another process already sends events to {topic.name} ({self._lock.note()}).",
                remedy="End that process.",
            )
        try:
            self.position = self._find_position()
        except _ProducerFailed as why:
            self._lock.release()
            raise self._describe_failure(str(why)) from None
        except BaseException:
            self._lock.release()
            raise

    def write(self, records: Iterable[Record]) -> None:
        """Send records. On return all are in the topic, or fewer if the producer had to start again: see
        ``position``. Raises SystemFailed."""
        written = self.position
        producer = self._connect()
        try:
            for record in records:
                self._send(producer, record)
                written = record.head.position
            self._wait(lambda: producer.flush(WAIT_S) == 0)
        except _ProducerFailed as why:
            self._restart(str(why))
            return
        self.position = written
        self._store()

    def close(self) -> None:
        """Close the producer; undelivered events are sent again next time."""
        self._drop_producer()
        self._lock.release()

    # -- internal ----------------------------------------------------------------------------

    def _send(self, producer: Any, record: Record) -> None:
        while True:
            try:
                producer.produce(
                    self._topic.name,
                    encode_cloudevent(record),
                    self._lab,
                    PARTITION,
                    on_delivery=self._on_delivery,
                    headers=HEADERS,
                )
                producer.poll(0)
                return
            except BufferError:  # the queue is full
                self._wait(lambda: bool(producer.poll(WAIT_S)))

    def _restart(self, why: str) -> None:
        """Start again with another producer, at the present end of the topic. Raises SystemFailed if there
        was no progress since the last time."""
        self._drop_producer()
        self._failure = ""
        self.position = self._find_position()
        if self.position <= self._begun_anew_at:
            raise self._describe_failure(why)
        self._begun_anew_at = self.position

    def _drop_producer(self) -> None:
        if self._producer is not None:
            self._producer.purge()
            self._producer = None

    def _connect(self) -> Any:
        if self._producer is None:
            from confluent_kafka import Producer

            self._producer = self._make_client(Producer, OURS)
        return self._producer

    def _make_client(self, kind: Any, settings: Mapping[str, Any]) -> Any:
        from confluent_kafka import KafkaException

        try:
            every = {**self._settings, **settings, "error_cb": self._on_error}
            return kind(every, logger=self._log)
        except KafkaException as error:
            reason = error.args[0]
            raise BadInput(
                f"The Kafka client refuses its settings: {reason.str()}.",
                remedy="Correct the settings in the file of --settings.",
            ) from None

    def _on_error(self, error: KafkaError) -> None:
        """Handle an error: the library continues by itself, unless it reports that it cannot."""
        if error.fatal():
            self._failure = error.str()
        elif not self._is_away:
            self._is_away = True
            self._report(f"Kafka at {self._topic.brokers} is unavailable ({error.str()}). LabOS tries again.")

    def _on_delivery(self, error: KafkaError | None, message: Message) -> None:
        if error is not None and not self._failure:
            self._failure = error.str()
        elif error is None and self._is_away:
            self._is_away = False
            self._report(f"Kafka at {self._topic.brokers} accepts events again.")

    def _wait(self, is_done: Callable[[], bool]) -> None:
        """Wait until it is done. Raises SystemFailed after ``patience_s``, and _BeginAnew for a producer that
        cannot continue."""
        began = time.monotonic()
        while not is_done() and not self._failure:
            if self._patience_s is not None and time.monotonic() - began > self._patience_s:
                raise self._describe_failure(f"no answer in {self._patience_s:g} s")
        if self._failure:
            raise _ProducerFailed(self._failure)

    def _describe_failure(self, why: str) -> SystemFailed:
        return SystemFailed(
            f"Kafka at {self._topic.brokers} does not accept the events: {why}.",
            remedy="Repair the broker, then start this command again: it continues at the end of the topic.",
        )

    # -- where to continue -------------------------------------------------------------------

    def _find_position(self) -> int:
        """The position of the last event of this lab in the topic; the stored position if the topic has none
        any more; 0 for a topic that was always empty."""
        from confluent_kafka import Consumer, KafkaError, KafkaException, TopicPartition
        from confluent_kafka.admin import AdminClient

        settings = {"group.id": "labos", "enable.auto.commit": False, "enable.partition.eof": True}
        consumer = self._make_client(Consumer, settings)
        admin = self._make_client(AdminClient, {})
        try:
            where = TopicPartition(self._topic.name, PARTITION)
            ends: list[tuple[int, int]] = []

            def ask() -> bool:
                try:
                    self._make_topic(admin)
                    ends[:] = [consumer.get_watermark_offsets(where, timeout=WAIT_S)]
                except KafkaException as error:
                    self._on_error(error.args[0])
                return bool(ends)

            self._wait(ask)
            low, high = ends[0]
            if high == 0:
                return 0
            where.offset = max(low, high - LOOKED_BACK)
            consumer.assign([where])
            found: list[int] = []

            def look() -> bool:
                message = consumer.poll(WAIT_S)
                if message is None:
                    return False
                if message.error() is not None:
                    return bool(message.error().code() == KafkaError._PARTITION_EOF)
                position = self._position_in(message.value() or b"")
                found.extend([position] if position else [])
                return bool(message.offset() >= high - 1)

            self._wait(look)
            self._is_away = False
            return found[-1] if found else self._count_stored()
        finally:
            consumer.close()

    def _make_topic(self, admin: Any) -> None:
        """Create the topic with one partition, unless it exists. Raises KafkaException."""
        from confluent_kafka import KafkaError, KafkaException
        from confluent_kafka.admin import NewTopic  # type: ignore[attr-defined]

        if self._topic.name in admin.list_topics(timeout=WAIT_S).topics:
            return
        try:
            admin.create_topics([NewTopic(self._topic.name, num_partitions=1)])[self._topic.name].result()
        except KafkaException as error:
            if error.args[0].code() != KafkaError.TOPIC_ALREADY_EXISTS:
                raise

    def _position_in(self, value: bytes) -> int:
        """The position of an event of this lab; 0 for anything else."""
        try:
            event = msgspec.json.decode(value)
            return int(event["position"]) if event["source"] == self._source else 0
        except (msgspec.MsgspecError, KeyError, TypeError, ValueError):
            return 0

    def _count_stored(self) -> int:
        try:
            known = msgspec.json.decode(self._file.read_bytes(), type=Stored)
        except FileNotFoundError:
            return 0
        except (OSError, msgspec.MsgspecError):
            raise BadInput(
                f"{self._file} does not contain the position of a topic.",
                remedy="Remove the file. Then all events are sent again.",
            ) from None
        same = known.topic == self._topic.name and known.source == self._source
        return known.position if same else 0

    def _store(self) -> None:
        replace_file(self._file, msgspec.json.encode(Stored(self._topic.name, self._source, self.position)))


def _need_library() -> None:
    try:
        import confluent_kafka
    except ModuleNotFoundError:
        raise BadInput(
            "The Kafka client is not installed.", remedy='Run: pip install "labos-sdl[kafka]"'
        ) from None
    assert confluent_kafka
