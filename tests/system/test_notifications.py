"""Notifications of a lab that runs, is killed, and is watched; on real processes and servers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.notify.servers import Hook, web_server
from tests.support.lab_process import Up, labos, until
from tests.support.processes import run_process


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--no-nodes")
    up.home.mkdir()
    yield up
    up.clean_up()


def write(lab: Up, url: str) -> None:
    text = f'module_grace: 1 h\ncontacts:\n  duty: {{webhook: "{url}"}}\n'
    (lab.home / "contacts.yaml").write_text(text)


def list_notifications(lab: Up, *options: str) -> list[dict[str, object]]:
    done = labos("notifications", "--json", "--home", str(lab.home), *options)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert isinstance(found, list)
    return found


def test_a_killed_kernel_is_told_by_who_watches(lab: Up) -> None:
    hook = Hook()
    with web_server(hook) as url:
        write(lab, url)
        lab.start("rpl")
        argv = [sys.executable, "-m", "labos", "notifications", "watch", "--home", str(lab.home)]
        with run_process(argv, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as watcher:
            lab.kill()
            until(lambda: hook.bodies, "the watcher tells of it")
            sent = [("duty", "sent")]
            until(
                lambda: [(d["contact"], d["state"]) for d in list_notifications(lab)] == sent,
                "it is noted as sent",
            )
            watcher.send_signal(signal.SIGINT)
            assert watcher.wait(60) == 0
        assert [body["title"] for body in hook.bodies] == ["the kernel has stopped"]
        assert "has expired" in str(hook.bodies[0]["text"])
        lab.options = ("--no-nodes",)
        lab.start()
        assert lab.interrupt() == 0
        assert len(hook.calls) == 1
        assert [(d["contact"], d["state"]) for d in list_notifications(lab)] == [("duty", "sent")]


def test_closed_in_order_nobody_is_told(lab: Up) -> None:
    hook = Hook()
    with web_server(hook) as url:
        write(lab, url)
        lab.start("rpl")
        assert lab.interrupt() == 0
        lab.options = ("--no-nodes",)
        lab.start()
        assert lab.interrupt() == 0
    assert hook.calls == []
    assert list_notifications(lab) == []


def test_a_test_message_and_its_failure(lab: Up) -> None:
    hook = Hook()
    with web_server(hook) as url:
        write(lab, url)
        done = labos("notifications", "test", "duty", "--home", str(lab.home))
        assert done.returncode == 0, done.stderr
        assert hook.bodies[0]["topic"] == "test"
        wrong = labos("notifications", "test", "dutty", "--home", str(lab.home))
        assert wrong.returncode == 1
        assert "Did you mean 'duty'?" in wrong.stderr
    failed = labos("notifications", "test", "duty", "--home", str(lab.home))
    assert failed.returncode == 1
    assert "cannot be reached" in failed.stderr


def test_a_wrong_contacts_file_is_refused_before_anything_starts(lab: Up) -> None:
    file = lab.home.parent / "people.yaml"
    file.write_text("contacts:\n  duty: {webhok: x}\n")
    done = labos("up", "rpl", "--simulate", "--home", str(lab.home), LABOS_CONTACTS=os.fspath(file))
    assert done.returncode == 1
    assert f"{file}:2:10: contacts.duty.webhok: The key 'webhok' is not known here." in done.stderr
    assert not (lab.home / "labos.db").exists()
