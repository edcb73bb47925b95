"""Notifications from a real log to real servers; time stands until a test moves it."""

from __future__ import annotations

import shutil
import sqlite3
import ssl
import subprocess
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest

from labos.core.decide.actions import DoubtAction, FinishAction
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import StartKernel
from labos.core.decide.nodes import JoinNode, LoseNode, ReportState
from labos.core.erasure import WordsErased
from labos.core.ids import InterventionId, LabId, ModuleName
from labos.core.modules import ModuleTakenOut
from labos.core.steps import WindowBreached
from labos.core.words import ERASED, PREFIX, Kept, keep
from labos.ports import Head
from labos.services.notify import Notifier, Outbox, load_contacts
from labos.services.notify.notifier import GIVEN_UP_S
from labos.services.shown import show_struct
from labos.settings import free_port
from labos.spec import parse_source
from labos.store import SqlEventStore, open_store
from tests.integration.notify.servers import Hook, Post, mail_server, web_server
from tests.unit.services.logbook import Logbook

ARM = ModuleName("rpl/pf400")


class Scene:
    """A lab on paper whose log is a real database, and a notifier that follows it."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self._stack = folder, stack
        self.book = Logbook()
        self.book.furnish()
        self.seconds = 0.0
        self.store: SqlEventStore = open_store(f"sqlite:///{folder / 'labos.db'}")
        stack.callback(self.store.close)
        self._head: Head = self.store.claim(LabId("lab-1"), "test", 3000.0)
        self._written = 0
        self.post, self.hook = Post(), Hook()
        self.smtp_port = free_port()
        self.url = stack.enter_context(web_server(self.hook))
        self.outbox = Outbox(folder / "notifications.db")
        stack.callback(lambda: self.outbox.close())
        self.notifier = self.open()

    def open(self, contacts: str = "") -> Notifier:
        """A notifier as after a start of the process."""
        self.outbox.close()
        self.outbox = Outbox(self.folder / "notifications.db")
        log = open_store(f"sqlite:///{self.folder / 'labos.db'}", create=False, read_only=True)
        self._stack.callback(log.close)
        text = (
            contacts
            or f"""\
smtp: {{host: 127.0.0.1, port: {self.smtp_port}, security: none, sender: lab@example.org}}
module_grace: 1 min
contacts:
  anna: {{email: anna@example.org}}
  duty: {{webhook: "{self.url}"}}
escalation:
  - notify: [anna]
  - {{notify: [duty], after: 15 min}}
"""
        )
        self.notifier = Notifier(log, self.outbox, load_contacts(parse_source(text)), self.book.clock)
        return self.notifier

    def turn(self, seconds: float = 0.0) -> None:
        """Write what was decided, let time pass, let the notifier work."""
        fresh = self.book.records[self._written :]
        if fresh:
            self._head = self.store.append(self._head, fresh)
            self._written = len(self.book.records)
        self.seconds += seconds
        self.book.at(self.seconds)
        self.notifier.turn()

    def ask(self) -> str:
        """An action whose end nobody knows: the lab asks a person."""
        run = self.book.submit("pcr")
        action = self.book.start(run, 0)
        self.book.do(DoubtAction(action, "the node went silent"), "labos")
        return f"I{self.book.state.interventions.named}"

    def states(self) -> list[tuple[str, int, str]]:
        return [(d.contact, d.level, d.state) for d in self.outbox.list_deliveries()]

    def letters(self) -> list[str]:
        return [str(letter["subject"]) for letter in self.post.letters]


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with ExitStack() as stack:
        yield Scene(tmp_path, stack)


@pytest.fixture
def mail(scene: Scene) -> Iterator[None]:
    with mail_server(scene.post, scene.smtp_port):
        yield


@pytest.mark.usefixtures("mail")
def test_a_question_is_told_and_escalates(scene: Scene) -> None:
    scene.turn()
    question = scene.ask()
    scene.turn()
    (letter,) = scene.post.letters
    assert letter["subject"] == f"[paper] {question}: the lab asks you"
    assert letter["to"] == "anna@example.org"
    assert f"labos resolve {question} done" in letter.get_content()
    event = scene.book.records[-1].head
    assert letter["message-id"] == f"<{event.id}.anna.0@lab-1.labos>"
    scene.turn(14 * 60)
    assert scene.hook.calls == []
    scene.turn(60)
    ((headers, body),) = scene.hook.calls
    assert headers["idempotency-key"] == body["id"] == f"{event.id}.duty.1"
    assert (body["position"], body["urgent"], body["about"]) == (
        event.position,
        True,
        f"intervention:{question}",
    )
    scene.turn(3600)
    assert len(scene.post.letters) == len(scene.hook.calls) == 1


@pytest.mark.usefixtures("mail")
def test_an_answered_question_escalates_no_more(scene: Scene) -> None:
    scene.turn()
    question = scene.ask()
    scene.turn()
    scene.book.do(ResolveIntervention(InterventionId(question), "not_done", "ada"))
    scene.turn(3600)
    assert scene.hook.calls == []
    assert scene.states() == [("anna", 0, "sent"), ("duty", 1, "withdrawn")]


@pytest.mark.usefixtures("mail")
def test_a_restart_neither_loses_nor_repeats(scene: Scene) -> None:
    scene.turn()
    scene.ask()
    scene.turn()
    scene.open()
    scene.turn()
    assert len(scene.post.letters) == 1
    scene.open()
    scene.turn(15 * 60)
    assert len(scene.hook.calls) == 1
    # What happened while nobody followed the log is told afterwards.
    scene.book.write([WindowBreached("R1", 0, 0, 60.0)])
    scene.open()
    scene.turn()
    assert scene.letters()[1:] == ["[paper] R1 missed a time window"]


@pytest.mark.usefixtures("mail")
def test_after_a_crash_between_sending_and_noting_it_bears_the_same_id(scene: Scene) -> None:
    scene.turn()
    scene.ask()
    scene.turn()
    with sqlite3.connect(scene.folder / "notifications.db") as past:
        past.execute("UPDATE delivery SET state = 'waiting' WHERE state = 'sent'")
    past.close()
    scene.open()
    scene.turn()
    first, second = (letter["message-id"] for letter in scene.post.letters)
    assert first == second


def test_a_dead_mail_server_is_tried_again_and_keeps_nobody_else_waiting(scene: Scene) -> None:
    scene.turn()
    scene.ask()
    scene.turn()
    (first, *_) = scene.outbox.list_deliveries()
    assert (first.state, first.attempts) == ("waiting", 1)
    assert "cannot be used" in first.error
    assert "anna@" not in first.error
    scene.turn(15 * 60)
    assert len(scene.hook.calls) == 1
    pauses = []
    for _ in range(8):
        (waiting,) = scene.outbox.list_deliveries(waiting=True)
        pauses.append(round((waiting.try_at - scene.book.clock.now) / 1e9))
        scene.turn(pauses[-1])
    assert pauses == [60, 120, 240, 480, 960, 1800, 1800, 1800]
    with mail_server(scene.post, scene.smtp_port):
        scene.turn(1800)
    assert len(scene.post.letters) == 1
    assert scene.states() == [("anna", 0, "sent"), ("duty", 1, "sent")]


def test_what_nobody_takes_for_days_is_given_up(scene: Scene) -> None:
    scene.turn()
    scene.hook.status = 500
    scene.ask()
    scene.turn()
    scene.turn(GIVEN_UP_S + 1000)
    scene.turn(1)
    assert ("anna", 0, "given_up") in scene.states()
    (duty,) = scene.outbox.list_deliveries("duty")
    assert "answered 500" in duty.error
    assert "secret-path" not in duty.error


@pytest.mark.usefixtures("mail")
def test_a_refused_letter_is_not_the_servers_fault(scene: Scene) -> None:
    scene.post.refuse = "550 anna@example.org is not known here"
    scene.turn()
    scene.ask()
    scene.turn()
    (first, *_) = scene.outbox.list_deliveries()
    assert "refused the message: 550 the address is not known here" in first.error


@pytest.mark.usefixtures("mail")
def test_a_module_that_comes_back_in_time_is_no_news(scene: Scene) -> None:
    scene.turn()
    scene.book.do(LoseNode(ARM, "i", "silent"), ARM)
    scene.turn(30)
    scene.book.do(JoinNode(ARM, "j", "i2", "pf400", "1", "", "IDLE", True), ARM)
    scene.turn(3600)
    assert scene.post.letters == []
    scene.book.do(LoseNode(ARM, "i2", "silent"), ARM)
    scene.turn()
    scene.turn(60)
    assert scene.letters() == ["[paper] pf400 is gone"]
    scene.turn(15 * 60)
    assert [body["title"] for body in scene.hook.bodies] == ["pf400 is gone"]


@pytest.mark.usefixtures("mail")
def test_a_module_in_error_is_told_once(scene: Scene) -> None:
    scene.turn()
    scene.book.do(ReportState(ARM, "ERROR", "motor 3 is hot"), ARM)
    scene.turn()
    scene.turn(61)
    assert scene.letters() == ["[paper] pf400 reports an error"]
    assert "motor 3 is hot" in scene.post.letters[0].get_content()
    scene.book.do(LoseNode(ARM, "i", "silent"), ARM)
    scene.turn(61)
    scene.turn(61)
    assert len(scene.post.letters) == 1


@pytest.mark.usefixtures("mail")
def test_modules_that_leave_while_the_lab_closes_are_no_news(scene: Scene) -> None:
    scene.turn()
    scene.notifier.begin_close()
    scene.book.do(LoseNode(ARM, "i", "silent"), ARM)
    scene.turn()
    scene.notifier.close()
    scene.book.do(LoseNode(ModuleName("rpl/hidex"), "i", "silent"), "labos")  # after the last look
    scene.book.do(StartKernel(2, "0.1.0"), "labos")
    scene.open()
    scene.turn()
    scene.turn(3600)
    assert scene.post.letters == []


@pytest.mark.usefixtures("mail")
def test_a_failed_run_is_told(scene: Scene) -> None:
    scene.turn()
    run = scene.book.submit("pcr")
    action = scene.book.start(run, 0)
    scene.book.do(FinishAction(action, 1, False, "none", None, "the tower is empty"), "node")
    scene.turn()
    assert f"[paper] {run} failed" in scene.letters()


@pytest.mark.usefixtures("mail")
def test_a_kernel_that_stops_is_told_to_everybody_at_once(scene: Scene) -> None:
    scene.turn()
    scene.notifier.on_kernel_stopped("The disk is full.")
    scene.turn()
    scene.turn()
    assert scene.letters() == ["[paper] the kernel has stopped"]
    assert [body["title"] for body in scene.hook.bodies] == ["the kernel has stopped"]
    scene.book.do(StartKernel(2, "0.1.0"), "labos")
    scene.open()
    scene.turn(3600)
    assert len(scene.post.letters) == 1


@pytest.mark.usefixtures("mail")
def test_a_kernel_that_was_killed_is_told_by_the_next(scene: Scene) -> None:
    scene.turn()
    scene.book.do(StartKernel(2, "0.1.0"), "labos")
    scene.open()
    scene.turn()
    assert scene.letters() == ["[paper] the kernel had stopped and runs again"]
    scene.notifier.close()
    scene.book.do(StartKernel(3, "0.1.0"), "labos")
    scene.open()
    scene.turn()
    assert len(scene.post.letters) == 1


@pytest.mark.usefixtures("mail")
def test_at_the_first_start_only_open_questions_are_told(scene: Scene) -> None:
    answered = scene.ask()
    scene.book.do(ResolveIntervention(InterventionId(answered), "gone", "ada"))
    question = scene.ask()
    scene.book.do(LoseNode(ARM, "i", "silent"), ARM)
    scene.turn()
    assert scene.letters() == [f"[paper] {question}: the lab asks you"]
    scene.turn(61)
    assert scene.letters()[1:] == ["[paper] pf400 is gone"]


@pytest.mark.filterwarnings("ignore:Requiring AUTH")
def test_a_login_and_its_password(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LABOS_TEST_SMTP", "geheim")
    port = free_port()
    scene.open(
        f"smtp: {{host: 127.0.0.1, port: {port}, security: none, sender: lab@example.org,"
        " user: labos, password: {env: LABOS_TEST_SMTP}}\n"
        "contacts: {anna: {email: anna@example.org}}\n"
    )
    with mail_server(scene.post, port, login=True):
        scene.turn()
        scene.ask()
        scene.turn()
    assert scene.post.logins == [("labos", "geheim")]
    assert len(scene.post.letters) == 1


def test_the_token_of_a_webhook(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LABOS_TEST_TOKEN", "offen")
    scene.open(f'contacts: {{duty: {{webhook: "{scene.url}", token: {{env: LABOS_TEST_TOKEN}}}}}}\n')
    scene.turn()
    scene.ask()
    scene.turn()
    ((headers, _),) = scene.hook.calls
    assert headers["authorization"] == "Bearer offen"


def test_the_outbox_holds_no_address(scene: Scene) -> None:
    scene.turn()
    scene.ask()
    scene.turn()
    assert b"example.org" not in (scene.folder / "notifications.db").read_bytes()
    payloads = b"".join(record.payload for record in scene.store.read())
    assert b"anna" not in payloads


def test_in_its_thread_it_is_woken(scene: Scene) -> None:
    arrived = threading.Event()
    calls = scene.hook.calls

    class Telling(list[Any]):
        def append(self, item: Any) -> None:
            calls.append(item)
            arrived.set()

    scene.hook.calls = Telling()
    scene.open(f'contacts: {{duty: {{webhook: "{scene.url}"}}}}\n')
    scene.turn()
    scene.notifier.start()
    scene.ask()
    scene.store.append(scene._head, scene.book.records[scene._written :])
    scene.notifier.wake()
    assert arrived.wait(60)
    scene.notifier.close()
    assert not scene.notifier.busy
    assert scene.states() == [("duty", 0, "sent")]


@pytest.mark.usefixtures("mail")
def test_with_a_full_disk_the_kernels_end_is_told_once(scene: Scene) -> None:
    scene.turn()
    scene.outbox._db.execute("PRAGMA max_page_count = 1")
    scene.outbox._db.execute("PRAGMA query_only = ON")
    scene.notifier.on_kernel_stopped("The disk is full.")
    scene.turn()
    scene.turn(60)
    assert scene.letters() == ["[paper] the kernel has stopped"]
    assert len(scene.hook.calls) == 1
    scene.outbox._db.execute("PRAGMA query_only = OFF")
    scene.turn(60)
    assert len(scene.post.letters) == 1
    assert {state for _, _, state in scene.states()} == {"sent"}


def test_mail_is_encrypted_and_its_server_checked(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate with")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"),
            *("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"),
            *("-keyout", str(key), "-out", str(certificate)),
        ],
        check=True,
        capture_output=True,
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    port = free_port()
    scene.open(
        f"smtp: {{host: localhost, port: {port}, sender: lab@example.org}}\n"
        "contacts: {anna: {email: anna@example.org}}\n"
    )
    scene.turn()
    scene.ask()
    with mail_server(scene.post, port, tls_context=context, require_starttls=True):
        scene.turn()
        (waiting,) = scene.outbox.list_deliveries()
        assert "certificate verify failed" in waiting.error
        assert scene.post.letters == []
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        scene.turn(30)
    assert len(scene.post.letters) == 1


def test_to_a_server_without_encryption_nothing_is_said(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LABOS_TEST_SMTP", "geheim")
    port = free_port()
    scene.open(
        f"smtp: {{host: localhost, port: {port}, sender: lab@example.org, user: labos,"
        " password: {env: LABOS_TEST_SMTP}}\n"
        "contacts: {anna: {email: anna@example.org}}\n"
    )
    scene.turn()
    scene.ask()
    with mail_server(scene.post, port):
        scene.turn()
    (waiting,) = scene.outbox.list_deliveries()
    assert "STARTTLS" in waiting.error
    assert (scene.post.letters, scene.post.logins) == ([], [])


def quarantine(scene: Scene, text: str) -> Kept:
    """The arm is out of service for a reason that a person wrote."""
    words = keep(text, bytes(range(16)))
    scene.book.write([ModuleTakenOut(ARM, words.reference, failures=3)])
    scene.book.records[-1] = msgspec.structs.replace(scene.book.records[-1], words=(words,))
    return words


def erase(scene: Scene, words: Kept) -> None:
    digest = words.reference.removeprefix(PREFIX)
    scene.book.write([WordsErased("", "personal", "ada", (digest,), (scene.book.position,))])


def list_kept(scene: Scene, text: str) -> bool:
    return any(text.encode() in file.read_bytes() for file in scene.folder.glob("notifications.db*"))


def test_a_message_that_waits_is_sent_without_what_was_erased(scene: Scene) -> None:
    scene.turn()
    words = quarantine(scene, "Zoë Quux dropped it")
    scene.turn()  # there is no mail server yet
    assert [state for _, _, state in scene.states()] == ["waiting", "waiting"]
    assert not list_kept(scene, "Quux")
    erase(scene, words)
    with mail_server(scene.post, scene.smtp_port):
        scene.turn(60)
    (letter,) = scene.post.letters
    assert "Quux" not in letter.get_content()
    assert ERASED in letter.get_content()


@pytest.mark.usefixtures("mail")
def test_a_message_that_was_sent_is_out_of_reach_and_shown_without_what_was_erased(scene: Scene) -> None:
    """Also the next one about the same thing, to somebody else."""
    scene.turn()
    words = quarantine(scene, "Zoë Quux dropped it")
    scene.turn()
    scene.turn(60)  # modules have a minute of grace
    (letter,) = scene.post.letters
    assert "Zoë Quux dropped it" in letter.get_content()
    assert not list_kept(scene, "Quux")
    erase(scene, words)
    scene.turn(15 * 60)
    ((_, body),) = scene.hook.calls
    assert "Quux" not in str(body)
    assert ERASED in body["text"]
    shown = [show_struct(scene.store, each) for each in scene.outbox.list_deliveries()]
    assert [(each.state, ERASED in each.notice.text) for each in shown] == [("sent", True), ("sent", True)]
