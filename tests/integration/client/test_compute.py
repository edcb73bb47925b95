"""Computations of an experiment: what the log says of them, workers that die, results that are large."""

from __future__ import annotations

import hashlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import Experiment, LabClient
from labos.client._record import LARGEST_IN_EVENT
from labos.errors import BadInput, LabosError, NotFound
from labos.services.compute import Attempts, ComputeFailed, digest_code, digest_value
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.integration.client import computations as work
from tests.support.lab_process import until


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabClient]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running, LabClient(running.url) as found:
        yield found


@pytest.fixture
def experiment(client: LabClient) -> Iterator[Experiment]:
    with Experiment(client, "computing", "bo") as found:
        found.configure_compute(pool=2)
        yield found


def notes(experiment: Experiment) -> list[dict[str, Any]]:
    return [
        event["payload"] for event in experiment.lab.events(type="experiment.noted", stream=experiment.id)
    ]


def test_a_computation_is_in_the_log_with_all_that_names_it(experiment: Experiment) -> None:
    assert experiment.compute(work.mean, [1.0, 2.0], scale=2.0) == {"mean": 3.0}
    (note,) = notes(experiment)
    facts = note["facts"]
    assert (note["kind"], note["name"]) == ("local_compute", f"{work.__name__}.mean")
    source = Path(work.__file__).read_bytes()
    assert facts["code"] == hashlib.sha256(source).hexdigest()
    assert facts["arguments"] == digest_value({"args": [[1.0, 2.0]], "named": {"scale": 2.0}})
    assert facts["result"] == {"mean": 3.0}
    assert facts["process"] != os.getpid()
    assert (facts["where"], facts["attempts"]) == ("pool", 1)
    assert facts["seconds"] >= 0


def test_many_are_computed_at_once_and_come_back_in_order(experiment: Experiment) -> None:
    assert experiment.compute_all(work.square, range(40)) == [n * n for n in range(40)]
    assert sorted(note["facts"]["result"] for note in notes(experiment)) == [n * n for n in range(40)]


def test_a_large_result_is_a_file_of_the_lab(experiment: Experiment) -> None:
    long = experiment.compute(work.spectrum, LARGEST_IN_EVENT)
    facts = notes(experiment)[-1]["facts"]
    assert "result" not in facts
    content = experiment.lab.file(facts["result_file"])
    assert content == str(long).replace(" ", "").encode()


def test_what_json_would_change_is_kept_as_it_is(experiment: Experiment) -> None:
    assert experiment.compute(work.pair, 1) == (1, 2)
    facts = notes(experiment)[-1]["facts"]
    assert facts["result_form"] == "pickle"
    assert pickle.loads(experiment.lab.file(facts["result_file"])) == (1, 2)


def test_a_worker_that_is_killed_is_followed_by_another(experiment: Experiment, tmp_path: Path) -> None:
    assert experiment.compute(work.die_once, str(tmp_path)) == "alive"
    (note,) = notes(experiment)
    assert note["facts"]["attempts"] == 2


@pytest.mark.slow
def test_workers_end_when_their_program_is_killed() -> None:
    """One that computes, and one that waits for work."""
    program = [sys.executable, "-m", work.__name__]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            workers = [int(word) for word in process.stdout.readline().split()]
        finally:
            process.kill()
    assert len(workers) == 2
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers), "they end")


def test_it_is_given_up_after_as_many_attempts_as_were_said(client: LabClient) -> None:
    with Experiment(client, "computing", "bo") as experiment:
        experiment.configure_compute(pool=1, attempts=Attempts(after_death=1))
        with pytest.raises(ComputeFailed, match="tried 2 times"):
            experiment.compute(work.die, 1)
        assert notes(experiment)[-1]["facts"]["attempts"] == 2
        assert experiment.compute(work.square, 3) == 9, "others are computed after it"


def test_an_error_of_the_function_is_told_and_not_repeated(experiment: Experiment) -> None:
    with pytest.raises(ComputeFailed, match=r"tried once.*ZeroDivisionError"):
        experiment.compute(work.divide, 0)
    facts = notes(experiment)[-1]["facts"]
    assert (facts["attempts"], facts["error"]) == (1, "ZeroDivisionError: division by zero")


def test_what_cannot_be_sent_is_said(experiment: Experiment) -> None:
    with pytest.raises(BadInput, match="cannot be sent"):
        experiment.compute(work.square, lambda: 1)
    with pytest.raises(NotFound, match="Known places: local, pool"):
        experiment.compute(work.square, 1, where="moon")
    with pytest.raises(BadInput, match=r"labos-sdl\[parsl\]|Give a parsl"):
        experiment.compute(work.square, 1, where="parsl")
    assert notes(experiment) == []


def test_a_file_is_kept_for_an_open_experiment_only(client: LabClient) -> None:
    with pytest.raises(LabosError, match="no experiment E99"):
        client.keep_file("E99", b"x")
    with Experiment(client, "computing", "bo") as experiment:
        name = experiment.keep_file(b"\0\xff")
        assert experiment.keep_file(b"\0\xff") == name
        assert client.file(name) == b"\0\xff"


def test_digests_do_not_depend_on_the_process() -> None:
    words = (
        "from labos.services.compute import digest_code as c; print(c(eval('lambda x: {x, (lambda: 2)()}')))"
    )
    told = {
        subprocess.run(
            [sys.executable, "-c", words], env={"PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2")
    }
    assert len(told) == 1
    assert digest_code(len) == ""


def test_the_client_stays_light() -> None:
    heavy = "{'multiprocessing', 'parsl', 'distributed', 'globus_sdk', 'globus_compute_sdk'}"
    words = f"import sys, labos.client; print({heavy} & {{*sys.modules}})"
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_without_the_kit_of_globus_it_is_said_what_to_install() -> None:
    words = (
        "import sys; sys.modules['globus_sdk'] = None\n"
        "from labos.errors import BadInput\n"
        "from labos.services.globus import GlobusEndpoint\n"
        "try: GlobusEndpoint('1', authorizer=object()).open()\n"
        "except BadInput as error: print(error.remedy)"
    )
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == 'pip install "labos-sdl[globus]"'


@pytest.mark.slow
def test_dask_computes(client: LabClient) -> None:
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    )
    with (
        cluster,
        distributed.Client(cluster) as dask,
        Experiment(client, "computing", "bo") as experiment,
    ):
        experiment.configure_compute(dask=dask)
        assert experiment.compute(work.square, 5, where="dask") == 25
        (note,) = notes(experiment)
        assert (note["kind"], note["facts"]["where"]) == ("compute", "dask")


@pytest.mark.slow
def test_parsl_computes_on_loopback(
    client: LabClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("parsl")
    # Parsl starts programs of its own by their names.
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    from parsl.config import Config
    from parsl.executors import HighThroughputExecutor
    from parsl.providers import LocalProvider

    executor = HighThroughputExecutor(
        label="loopback",
        address="127.0.0.1",
        max_workers_per_node=1,
        encrypted=False,
        provider=LocalProvider(init_blocks=1, max_blocks=1),
    )
    config = Config(executors=[executor], run_dir=str(tmp_path), strategy="none", initialize_logging=False)
    with Experiment(client, "computing", "bo") as experiment:
        experiment.configure_compute(parsl=config)
        assert experiment.compute(work.mean, [4.0], where="parsl") == {"mean": 4.0}
        (note,) = notes(experiment)
        assert (note["kind"], note["facts"]["where"]) == ("compute", "parsl")
        assert note["facts"]["process"] != os.getpid()
