"""What Globus does for an experiment, with Globus' own SDK against a stand-in of its services.

No test has seen Globus itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import Experiment, FlowFailed, LabClient, TransferFailed
from labos.errors import BadInput
from labos.services.compute import Attempts, ComputeFailed
from labos.services.globus import (
    GlobusCarrier,
    GlobusEndpoint,
    GlobusFailed,
    GlobusFlow,
    GlobusIndex,
    GlobusRefused,
    GlobusTimes,
    GlobusUnreachable,
)
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.integration.client import computations as work
from tests.support.globus import TOKEN, Globus, serve

sdk = pytest.importorskip("globus_sdk")
pytest.importorskip("globus_compute_sdk")
pytestmark = pytest.mark.slow  # the gate installs the SDK for these

ENDPOINT, FLOW, INDEX, HERE, THERE = (
    f"{digit}0000000-0000-4000-8000-000000000000" for digit in ("1", "2", "3", "4", "5")
)
SOON = GlobusTimes(first_s=0.02, longest_s=0.1, silence_s=20.0, settle_s=0.05)
BRIEF = GlobusTimes(first_s=0.02, longest_s=0.05, silence_s=0.2, settle_s=0.02)
CONTENT = b"well,value\nA1,0.5\n"
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running.url


@pytest.fixture(scope="module")
def lab(url: str) -> Iterator[LabClient]:
    with LabClient(url) as found:
        yield found


@pytest.fixture
def fake() -> Iterator[Fake]:
    with serve() as (globus, url):
        yield Fake(globus, url)


class Fake:
    """The stand-in, and clients for it as an application makes them."""

    def __init__(self, globus: Globus, url: str) -> None:
        self.globus, self.url = globus, url

    def access(self, patience: GlobusTimes = SOON) -> dict[str, Any]:
        authorizer = sdk.AccessTokenAuthorizer(TOKEN)
        return {"authorizer": authorizer, "base_url": self.url, "patience": patience}

    def endpoint(self, patience: GlobusTimes = SOON) -> GlobusEndpoint:
        return GlobusEndpoint(ENDPOINT, **self.access(patience))

    def flow(self, attempts: int = 1) -> GlobusFlow:
        return GlobusFlow("analyse", FLOW, attempts=attempts, **self.access())

    def index(self) -> GlobusIndex:
        return GlobusIndex(INDEX, visible_to=["public"], **self.access())

    def carrier(self, patience: GlobusTimes = SOON) -> GlobusCarrier:
        return GlobusCarrier(**self.access(patience))


@contextlib.contextmanager
def program(
    lab: LabClient, fake: Fake, *, resume: str = "", patience: GlobusTimes = SOON
) -> Iterator[Experiment]:
    with Experiment(lab, "far away", "ada", resume=resume, keep_open=True) as experiment:
        experiment.configure_compute(globus=fake.endpoint(patience), attempts=Attempts(after_death=2))
        experiment.configure_transfer(globus=fake.carrier(patience))
        yield experiment


def notes(lab: LabClient, experiment: str, kind: str) -> list[dict[str, Any]]:
    found = (event["payload"] for event in lab.events(type="experiment.noted", stream=experiment))
    return [note for note in found if note["kind"] == kind]


def states(lab: LabClient, experiment: str) -> list[str]:
    return [note["facts"]["state"] for note in notes(lab, experiment, "flow")]


# -- Compute --------------------------------------------------------------------------------------


def test_a_function_is_computed_at_an_endpoint(lab: LabClient, fake: Fake) -> None:
    with program(lab, fake) as experiment:
        assert experiment.compute(work.mean, [1.0, 2.0], scale=2.0, where="globus") == {"mean": 3.0}
        assert experiment.compute_all(work.square, range(6), where="globus") == [0, 1, 4, 9, 16, 25]
    first = notes(lab, experiment.id, "compute")[0]
    assert (first["facts"]["where"], first["facts"]["attempts"]) == ("globus", 1)
    assert first["facts"]["result"] == {"mean": 3.0}
    assert len(fake.globus.executed) == 7
    told = states(lab, experiment.id)
    assert (told.count("sending"), told.count("sent")) == (7, 7)


def test_a_worker_that_dies_is_followed_by_another_and_an_error_is_told(lab: LabClient, fake: Fake) -> None:
    fake.globus.deaths = ["WorkerLost: the node was taken away"]
    with program(lab, fake) as experiment:
        assert experiment.compute(work.square, 3, where="globus") == 9
        with pytest.raises(ComputeFailed, match=r"tried once.*ZeroDivisionError: division by zero"):
            experiment.compute(work.divide, 0, where="globus")
        fake.globus.deaths = ["ManagerLost"] * 3
        with pytest.raises(ComputeFailed, match=r"tried 3 times.*WorkerLost"):
            experiment.compute(work.square, 4, where="globus")
    facts = [note["facts"] for note in notes(lab, experiment.id, "compute")]
    assert [fact["attempts"] for fact in facts] == [2, 1, 3]
    assert len(fake.globus.executed) == 2 + 1 + 3


@pytest.mark.parametrize("how", [429, 503, 500, "cut", "lost"])
def test_a_task_is_sent_once_whatever_becomes_of_the_answer(lab: LabClient, fake: Fake, how: Any) -> None:
    with program(lab, fake) as experiment:
        assert experiment.compute(work.square, 2, where="globus") == 4
        fake.globus.fail("POST /v3/endpoints/*/submit", how, *([] if how == "lost" else [how]))
        fake.globus.fail("GET /v2/tasks/*", 503, "cut")
        assert experiment.compute(work.square, 3, where="globus") == 9
    assert len(fake.globus.executed) == 2


def test_who_is_not_let_in_is_told_and_goes_on_later(lab: LabClient, fake: Fake) -> None:
    with program(lab, fake) as experiment:
        assert experiment.compute(work.square, 2, where="globus") == 4
        fake.globus.lets_in = set()
        with pytest.raises(GlobusRefused, match="refuses the program's credentials") as caught:
            experiment.compute(work.square, 3, where="globus")
        assert "Sign in again" in caught.value.remedy
        fake.globus.lets_in = {TOKEN}
        assert experiment.compute(work.square, 3, where="globus") == 9
    assert len(fake.globus.executed) == 2
    assert len(notes(lab, experiment.id, "compute")) == 2, "of what was refused there is no result"


def test_a_service_that_stays_silent_is_given_up_and_asked_again_later(lab: LabClient, fake: Fake) -> None:
    with program(lab, fake, patience=BRIEF) as experiment:
        assert experiment.compute(work.square, 2, where="globus") == 4
        fake.globus.fail("GET /v2/tasks/*", *[503] * 200)
        with pytest.raises(GlobusUnreachable, match="does not answer"):
            experiment.compute(work.square, 3, where="globus")
        fake.globus.faults.clear()
        assert experiment.compute(work.square, 3, where="globus") == 9
    assert len(fake.globus.executed) == 2


def test_a_place_without_access_is_refused(lab: LabClient, fake: Fake) -> None:
    with pytest.raises(BadInput, match="has no credentials for Globus Compute"):
        GlobusEndpoint(ENDPOINT)
    with Experiment(lab, "far away", "ada") as experiment:
        experiment.configure_compute(globus=ENDPOINT)
        with pytest.raises(BadInput, match="needs an endpoint"):
            experiment.compute(work.square, 2, where="globus")


# -- Flows ----------------------------------------------------------------------------------------


def test_a_flow_is_carried_out_by_globus(lab: LabClient, fake: Fake) -> None:
    with program(lab, fake) as experiment:
        result = experiment.run_flow(fake.flow(), values=[1.0, 2.0])
    assert (result.status, result.state["output"]["Fit"]) == ("succeeded", {"mean": 3.0})
    assert states(lab, experiment.id) == ["started", "sending", "sent", "succeeded"]
    ended = notes(lab, experiment.id, "flow")[-1]["facts"]
    assert [(step["state"], step["code"]) for step in ended["states"]] == [
        ("Extract", "ActionStarted"),
        ("Extract", "ActionCompleted"),
        ("Fit", "ActionStarted"),
        ("Fit", "ActionCompleted"),
    ]
    assert list(fake.globus.runs) == [ended["globus_run"]]


def test_a_flow_that_fails_is_started_again_as_often_as_said(lab: LabClient, fake: Fake) -> None:
    fake.globus.run_ends = ["FAILED", "SUCCEEDED", "FAILED"]
    with program(lab, fake) as experiment:
        assert experiment.run_flow(fake.flow(attempts=2)).status == "succeeded"
        with pytest.raises(FlowFailed, match="Step 'Fit' of the flow 'analyse' failed: FlowFailed"):
            experiment.run_flow(fake.flow())
    told = states(lab, experiment.id)
    assert told.count("retrying") == 1
    assert told[-1] == "failed"
    assert len(fake.globus.runs) == 3


@pytest.mark.parametrize("how", [429, 503, "cut", "lost"])
def test_a_flow_is_started_once_whatever_becomes_of_the_answer(lab: LabClient, fake: Fake, how: Any) -> None:
    fake.globus.fail("POST /flows/*/run", how)
    fake.globus.fail("GET /runs/*", 503, "cut")
    with program(lab, fake) as experiment:
        assert experiment.run_flow(fake.flow()).status == "succeeded"
    assert len(fake.globus.runs) == 1


def test_a_flow_that_stands_still_is_told(lab: LabClient, fake: Fake) -> None:
    fake.globus.run_ends = ["INACTIVE"]
    with program(lab, fake) as experiment, pytest.raises(GlobusRefused, match="has stopped") as caught:
        experiment.run_flow(fake.flow())
    assert "and resume it" in caught.value.remedy


# -- Transfer -------------------------------------------------------------------------------------

SOURCE, TARGET = f"globus://{HERE}/plates/p1.csv", f"globus://{THERE}/archive/p1.csv"


def test_a_file_is_carried_by_globus(lab: LabClient, fake: Fake) -> None:
    fake.globus.files[HERE, "/plates/p1.csv"] = CONTENT
    with program(lab, fake) as experiment:
        done = experiment.transfer(SOURCE, TARGET, sha256=SHA256)
    assert (done.bytes, done.sha256) == (len(CONTENT), SHA256)
    assert fake.globus.files[THERE, "/archive/p1.csv"] == CONTENT
    (note,) = notes(lab, experiment.id, "transfer")
    assert (note["facts"]["source"], note["facts"]["where"]) == (SOURCE, "globus")
    assert states(lab, experiment.id) == ["sending", "sent"]


@pytest.mark.parametrize("how", [429, 503, "cut", "lost"])
def test_a_file_is_submitted_once_whatever_becomes_of_the_answer(
    lab: LabClient, fake: Fake, how: Any
) -> None:
    fake.globus.files[HERE, "/plates/p1.csv"] = CONTENT
    fake.globus.fail("POST /v0.10/transfer", how, how)
    fake.globus.fail("GET /v0.10/task/*", 503)
    with program(lab, fake) as experiment:
        experiment.transfer(SOURCE, TARGET)
    assert len(fake.globus.transfers) == 1
    assert fake.globus.count("POST /v0.10/transfer") == 3


def test_a_file_that_is_not_what_was_said_fails_and_is_tried_again(lab: LabClient, fake: Fake) -> None:
    fake.globus.files[HERE, "/plates/p1.csv"] = b"something else"
    with program(lab, fake) as experiment:
        with pytest.raises(TransferFailed, match="VERIFY_CHECKSUM_MISMATCH"):
            experiment.transfer(SOURCE, TARGET, sha256=SHA256)
        assert (THERE, "/archive/p1.csv") not in fake.globus.files
        fake.globus.files[HERE, "/plates/p1.csv"] = CONTENT
        assert experiment.transfer(SOURCE, TARGET, sha256=SHA256).sha256 == SHA256
    assert states(lab, experiment.id) == ["sending", "sent", "failed", "sending", "sent"]
    (note,) = notes(lab, experiment.id, "transfer")
    assert note["key"] == "transfer p1.csv#1"


def test_a_transfer_that_cannot_be_is_refused(lab: LabClient, fake: Fake) -> None:
    with program(lab, fake) as experiment:
        with pytest.raises(BadInput, match="between two collections"):
            experiment.transfer("p1.csv", TARGET)
        with pytest.raises(BadInput, match="not a file of a Globus collection"):
            experiment.transfer(SOURCE, "globus://")
        fake.globus.lets_in = set()
        with pytest.raises(GlobusRefused, match="Globus Transfer refuses the program's credentials"):
            experiment.transfer(SOURCE, TARGET)
        fake.globus.lets_in = {TOKEN}
        fake.globus.files[HERE, "/plates/p1.csv"] = CONTENT
        fake.globus.transfer_ends = ["INACTIVE"]
        with pytest.raises(GlobusRefused, match="has stopped"):
            experiment.transfer(SOURCE, TARGET)
    with (
        Experiment(lab, "far away", "ada") as experiment,
        pytest.raises(BadInput, match="has no credentials for"),
    ):
        experiment.transfer(SOURCE, TARGET)


# -- Search ---------------------------------------------------------------------------------------


def test_a_publication_stands_in_an_index_of_globus(lab: LabClient, fake: Fake) -> None:
    with program(lab, fake) as experiment:
        experiment.publish("A grey", keywords=["grey"], files={"p1.csv": CONTENT}, index=fake.index())
    (((index, subject), entry),) = fake.globus.entries.items()
    (note,) = notes(lab, experiment.id, "publication")
    assert (index, entry["visible_to"]) == (INDEX, ["public"])
    assert entry["content"] == {**note["facts"], "experiment": experiment.id, "application": "far away"}
    assert subject.endswith("/publication A grey#1")
    assert states(lab, experiment.id) == ["sending", "sent", "indexed"]


@pytest.mark.parametrize("how", [429, 503, "cut", "lost"])
def test_an_entry_stands_in_the_index_once(lab: LabClient, fake: Fake, how: Any) -> None:
    fake.globus.fail("POST /v1/index/*/ingest", how)
    with program(lab, fake) as experiment:
        experiment.publish("A grey", index=fake.index())
    assert len(fake.globus.entries) == 1
    assert len(notes(lab, experiment.id, "publication")) == 1


def test_an_entry_that_the_index_does_not_take_is_told(lab: LabClient, fake: Fake) -> None:
    fake.globus.ingest_ends = ["FAILED", "SUCCESS"]
    with program(lab, fake) as experiment:
        with pytest.raises(GlobusFailed, match="no such type"):
            experiment.publish("A grey", index=fake.index())
        experiment.publish("A grey", index=fake.index())
    assert states(lab, experiment.id) == ["sending", "sent", "failed", "sending", "sent", "indexed"]
    assert len(notes(lab, experiment.id, "publication")) == 1
    with pytest.raises(BadInput, match="who may see"):
        GlobusIndex(INDEX, visible_to="public", app=object())


# -- a program that is killed ---------------------------------------------------------------------

ROOT = Path(__file__).parents[3]
SENDING = {
    "compute": "POST /v3/endpoints/*/submit",
    "flow": "POST /flows/*/run",
    "transfer": "POST /v0.10/transfer",
    "publication": "POST /v1/index/*/ingest",
}


def start(url: str, fake: Fake, resume: str = "") -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "tests.integration.client.far_away", url, fake.url, resume]
    return subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("how", ["cut", "lost"])
@pytest.mark.parametrize("what", SENDING)
def test_a_program_that_is_killed_while_it_sends_sends_nothing_twice(
    lab: LabClient, url: str, fake: Fake, what: str, how: str
) -> None:
    fake.globus.files[HERE, "/plates/p1.csv"] = CONTENT
    killed = start(url, fake)
    before = ["served"] if what == "compute" else []  # the first task only opens the group
    fake.globus.fail(SENDING[what], *before, (how, killed.pid))
    killed.communicate(timeout=90)
    assert killed.returncode == -signal.SIGKILL
    experiment = max((event["stream"] for event in lab.events(type="experiment.started")), key=_number)
    for _ in range(2 if what == "publication" else 1):  # it goes on; then all is read from the log
        again = start(url, fake, experiment)
        told, errors = again.communicate(timeout=90)
        assert again.returncode == 0, errors
        assert told.split() == ["9", "3.0", str(len(CONTENT)), "published"]
    assert len(fake.globus.executed) == 1
    assert (len(fake.globus.runs), len(fake.globus.transfers), len(fake.globus.entries)) == (1, 1, 1)
    assert len(notes(lab, experiment, "publication")) == 1


def _number(experiment: str) -> int:
    return int(experiment.removeprefix("E"))
