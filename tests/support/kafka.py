"""A broker of Apache Kafka on loopback, unmodified, as a process that is killed and started again.

``python tests/foreign/make.py kafka`` gets it; a test that finds none skips.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any, Self

from labos.settings import free_port
from tests.support.foreign import java_libraries_of

START_S = 180.0
"""So long it may take where much else is under way."""

PROPERTIES = """
process.roles=broker,controller
node.id=1
controller.quorum.voters=1@127.0.0.1:{controller}
listeners=PLAINTEXT://127.0.0.1:{port},CONTROLLER://127.0.0.1:{controller}
advertised.listeners=PLAINTEXT://127.0.0.1:{port}
controller.listener.names=CONTROLLER
inter.broker.listener.name=PLAINTEXT
log.dirs={folder}/data
offsets.topic.replication.factor=1
group.initial.rebalance.delay.ms=0
auto.create.topics.enable=false
"""
JAVA = ("-Xmx256m", "-Xshare:auto", "-XX:TieredStopAtLevel=1", "-XX:+UseSerialGC")


class KafkaBroker:
    """One broker, which is its own controller (KRaft)."""

    def __init__(self, folder: Path) -> None:
        self._libraries = java_libraries_of("kafka")
        self.folder, self.port = folder, free_port()
        folder.mkdir(parents=True, exist_ok=True)
        self._properties = folder / "server.properties"
        told = PROPERTIES.format(port=self.port, controller=free_port(), folder=folder)
        self._properties.write_text(told)
        self._process: subprocess.Popen[bytes] | None = None
        format_ = ("kafka.tools.StorageTool", "format", "-t", "MkU3OEVBNTcwNTJENDM2Qk", "-c")
        subprocess.run(self._command(*format_), check=True, capture_output=True, timeout=START_S)

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

    def start(self) -> None:
        """Start it, and wait until it answers."""
        with (self.folder / "broker.log").open("ab") as log:
            self._process = subprocess.Popen(
                self._command("kafka.Kafka"), stdout=log, stderr=log, stdin=subprocess.DEVNULL
            )
        until = time.monotonic() + START_S
        while not self._answers():
            if self._process.poll() is not None or time.monotonic() > until:
                self.kill()
                raise AssertionError((self.folder / "broker.log").read_text()[-3000:])

    def kill(self) -> None:
        """kill -9."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def send(self, signal: int) -> None:
        """Freeze it, or let it go on."""
        assert self._process is not None
        os.kill(self._process.pid, signal)

    def values(self, topic: str) -> list[dict[str, Any]]:
        """All messages of a topic, in the order in which they stand there."""
        return [json.loads(message.value()) for message in self.messages(topic)]

    def messages(self, topic: str) -> list[Any]:
        """None of a topic that is not there, or whose broker is not ready yet."""
        from confluent_kafka import Consumer, KafkaException, TopicPartition

        settings = {"bootstrap.servers": self.address, "group.id": "reader", "enable.auto.commit": False}
        consumer = Consumer(settings)
        try:
            where = TopicPartition(topic, 0, 0)
            try:
                _, high = consumer.get_watermark_offsets(where, timeout=60)
            except KafkaException:  # there is no such topic yet, or it has no leader again yet
                return []
            consumer.assign([where])
            found: list[Any] = []
            until = time.monotonic() + 60
            while high and (not found or found[-1].offset() < high - 1):
                message = consumer.poll(1.0)
                assert time.monotonic() < until, f"{len(found)} of {high} messages"
                if message is not None and message.error() is None:
                    found.append(message)
            return found
        finally:
            consumer.close()

    def delete(self, topic: str, before: int) -> None:
        """Let the messages before an offset expire."""
        from confluent_kafka import TopicPartition

        where = TopicPartition(topic, 0, before)
        admin = self._admin()  # which has to live until it is done
        for done in admin.delete_records([where]).values():
            done.result(60)

    def _command(self, *words: str) -> list[str]:
        return ["java", *JAVA, "-cp", f"{self._libraries}/*", *words, str(self._properties)]

    def _answers(self) -> bool:
        from confluent_kafka import KafkaException

        try:
            return bool(self._admin().list_topics(timeout=2).brokers)
        except KafkaException:
            return False

    def _admin(self) -> Any:
        import logging

        from confluent_kafka.admin import AdminClient

        quiet = logging.getLogger("tests.kafka")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False
        return AdminClient({"bootstrap.servers": self.address}, logger=quiet)
