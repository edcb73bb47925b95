"""Events go to a real broker of Kafka: in order, each at least once, whoever is killed."""

from __future__ import annotations

import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.audit.cloudevents import encode_cloudevent
from labos.audit.kafka import KafkaSink, KafkaTopic, read_settings
from labos.cli.app import main
from labos.core.envelope import Record
from labos.core.ids import LabId
from labos.errors import BadInput, SystemFailed
from labos.store import open_store
from tests.integration.audit.logs import golden
from tests.support.audited import audit_lab
from tests.support.kafka import KafkaBroker
from tests.support.lab_process import until
from tests.unit.services.logbook import Logbook

RECORDS = golden("simulated-1")
LAB = RECORDS[0].head.lab


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KafkaBroker]:
    with KafkaBroker(tmp_path_factory.mktemp("kafka") / "broker") as running:
        yield running


def sink(broker: KafkaBroker, topic: str, folder: Path, **more: float) -> KafkaSink:
    patience_s = more.get("patience_s", 120.0)
    return KafkaSink(
        KafkaTopic(broker.address, topic), LAB, folder / f"{topic}.json", {}, patience_s=patience_s
    )


def grow(book: Logbook, home: Path) -> None:
    """Write to the log what it does not have yet."""
    store = open_store(f"sqlite:///{home / 'labos.db'}", home=home)
    try:
        head = store.claim(LabId(book.records[0].head.lab), "test", 30.0)
        head = store.append(head, book.records[head.position :])
        store.release(head.epoch)
    finally:
        store.close()


def expect(found: list[dict[str, object]], records: list[Record]) -> None:
    """Each event is there; the first of each in order; what comes again begins behind a kill."""
    firsts: dict[int, object] = {}
    for event in found:
        firsts.setdefault(int(str(event["position"])), event["hash"])
    assert list(firsts) == [record.head.position for record in records]
    assert list(firsts.values()) == [record.hash.hex() for record in records]


@pytest.mark.slow
def test_events_go_into_the_topic_in_order_and_go_on_where_it_ends(
    broker: KafkaBroker, tmp_path: Path
) -> None:
    for begin, end in ((0, 100), (100, 101), (101, len(RECORDS))):
        to = sink(broker, "lab", tmp_path)
        assert to.position == begin
        to.write(RECORDS[begin:end])
        assert to.position == end
        to.close()
    messages = broker.messages("lab")
    assert [message.value() for message in messages] == [encode_cloudevent(record) for record in RECORDS]
    assert {message.key() for message in messages} == {LAB.encode()}
    assert messages[0].headers() == [("content-type", b"application/cloudevents+json; charset=UTF-8")]


@pytest.mark.slow
def test_what_the_topic_says_goes_before_what_is_kept(broker: KafkaBroker, tmp_path: Path) -> None:
    first = sink(broker, "kept", tmp_path)
    first.write(RECORDS[:50])
    first.close()
    (tmp_path / "kept.json").unlink()
    again = sink(broker, "kept", tmp_path)
    assert again.position == 50, "from the topic alone"
    again.write(RECORDS[50:60])
    with pytest.raises(BadInput, match="Another process"):
        sink(broker, "kept", tmp_path)
    again.close()
    broker.delete("kept", 60)
    expired = sink(broker, "kept", tmp_path)
    assert expired.position == 60, "from the file alone"
    expired.close()
    (tmp_path / "kept.json").write_text("not JSON")
    with pytest.raises(BadInput, match=r"position of a topic\. Remove the file"):
        sink(broker, "kept", tmp_path)
    elsewhere = KafkaSink(
        KafkaTopic(broker.address, "kept"), "another-lab", tmp_path / "other.json", {}, patience_s=60
    )
    assert elsewhere.position == 0, "what another lab sent is not ours"
    elsewhere.close()


@pytest.mark.slow
def test_a_broker_that_is_killed_gets_everything_after_all(tmp_path: Path) -> None:
    """The command follows a lab's log; the broker dies, the lab goes on, the broker comes back."""
    book = audit_lab()
    book.save(tmp_path / "lab")
    with KafkaBroker(tmp_path / "broker") as broker:
        with Exporter(tmp_path, broker) as exporter:
            until(lambda: len(broker.values("lab")) >= book.position, "all events", 120)
            broker.kill()
            book.submit("pcr", "bo")
            grow(book, tmp_path / "lab")
            until(lambda: "is unavailable" in exporter.read_log(), "a word that it is away", 120)
            broker.start()
            until(lambda: len(broker.values("lab")) >= book.position, "the later events", 120)
            assert "accepts events again" in exporter.read_log()
        expect(broker.values("lab"), book.records)


class Exporter:
    """`labos export events --follow` to a broker, as a process."""

    def __init__(self, folder: Path, broker: KafkaBroker) -> None:
        self._folder = folder
        to = f"kafka://{broker.address}/lab"
        command = ["labos.__main__", "export", "events", "--to", to, "--follow", "--home", folder / "lab"]
        self._argv = [sys.executable, "-m", *map(str, command)]
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Exporter:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

    def start(self) -> None:
        with (self._folder / "exporter.log").open("ab") as log:
            self._process = subprocess.Popen(self._argv, stdout=log, stderr=log)

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def read_log(self) -> str:
        return (self._folder / "exporter.log").read_text()


@pytest.mark.full
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", range(3))
def test_kills_at_any_moment_leave_nothing_out(tmp_path: Path, seed: int) -> None:
    """Exporter and broker are killed or frozen twenty times while the log grows."""
    choose = random.Random(seed)
    book = audit_lab()
    book.save(tmp_path / "lab")
    with KafkaBroker(tmp_path / "broker") as broker, Exporter(tmp_path, broker) as exporter:
        until(lambda: bool(broker.values("lab")), "the first events", 180)
        for _ in range(20):
            book.submit(choose.choice(["pcr", "cp_newplate"]), "bo")
            grow(book, tmp_path / "lab")
            match choose.randrange(4):
                case 0:
                    exporter.kill()
                    exporter.start()
                case 1:
                    broker.kill()
                    broker.start()
                case 2:
                    broker.kill()
                    exporter.kill()
                    exporter.start()
                    broker.start()
                case 3:
                    broker.send(signal.SIGSTOP)
                    time.sleep(choose.uniform(0.1, 3.0))
                    broker.send(signal.SIGCONT)
        wanted = book.position
        until(lambda: wanted in [int(e["position"]) for e in broker.values("lab")], "all events", 180)
        expect(broker.values("lab"), book.records)


def test_a_broker_that_is_not_there_is_given_up_in_time(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        topic = KafkaTopic(f"127.0.0.1:{silent.getsockname()[1]}", "lab")
        with pytest.raises(SystemFailed, match="no answer in"):
            KafkaSink(topic, LAB, tmp_path / "kafka.json", {}, patience_s=0.5)


def test_bad_targets_and_settings_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for url in ("kafka://broker", "kafka://broker:1/a/b", "kafka://ada:secret@broker:1/lab"):
        with pytest.raises(BadInput, match="BROKER:9092") as refused:
            KafkaTopic.parse(url)
        assert "secret" not in str(refused.value)
    file = tmp_path / "kafka.properties"
    file.write_text("# of the broker\n\nsasl.username = labos\nsasl.password=a=b\n")
    assert read_settings(file) == {"sasl.username": "labos", "sasl.password": "a=b"}
    for text, said in (
        ("nonsense", ":1: this line is not a setting"),
        ("\nacks=0", ":2: LabOS itself sets acks"),
    ):
        file.write_text(text)
        with pytest.raises(BadInput, match=said):
            read_settings(file)
    file.write_text("no.such.setting=1")
    with pytest.raises(BadInput, match=r"no\.such\.setting"):
        KafkaSink(KafkaTopic("127.0.0.1:1", "lab"), LAB, tmp_path / "k.json", read_settings(file))
    monkeypatch.setenv("LABOS_HOME", str(tmp_path))
    audit_lab().save(tmp_path)
    for words, said in (
        (["--to", "amqp://broker/x"], "not a target"),
        (["--settings", str(file)], "are only for Kafka"),
        (["--to", "kafka://broker:1/lab", "--family", "run"], "--to"),
    ):
        assert main(["export", "events", *words]) == 1
        assert said in capsys.readouterr().err
