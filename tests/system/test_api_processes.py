"""API processes as they run: beside a kernel that dies, on a secure bus, over a replica of the log.

Whatever dies, and whoever is asked again with the same key: nothing is done twice, and nothing is lost that
was said to be done.
"""

from __future__ import annotations

import itertools
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import psycopg
import pytest

from labos.client import LabClient
from labos.settings import free_port
from tests.docs.markdown import ROOT
from tests.support.api_process import ApiProcess
from tests.support.lab_process import Up, labos, until
from tests.support.postgres import PostgresServer
from tests.system.test_standby import CELL as SMALL_CELL
from tests.system.test_standby import Pair

pytestmark = pytest.mark.timeout(240)

STACK = "wc.pile"
CELL = SMALL_CELL.replace("stations:\n", "stations:\n  wc.pile: {kind: stack, capacity: 500}\n")


class Lab:
    """A simulated lab without nodes whose ports stay, and API processes beside it."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder = folder
        ports = ("--bus-port", str(free_port()), "--http-port", str(free_port()))
        self.up = Up(folder / "lab", "--simulate", "--no-nodes", "--quiet", *ports, *options)
        self.processes: list[ApiProcess] = []

    def start(self) -> None:
        cell = self.folder / "rpl.yaml"
        cell.write_text(CELL)
        self.up.start(str(cell))

    def add(self, name: str, *options: str) -> ApiProcess:
        made = ApiProcess(self.folder, name, free_port(), "--home", str(self.up.home), *options)
        self.processes.append(made)
        return made.start()

    def count_loaded(self) -> int:
        """How many plates were put on the stack, as the log has it."""
        return self.up.types().count("station.loaded")

    def clean_up(self) -> None:
        for process in self.processes:
            process.kill()
        if self.up.process is not None and self.up.process.poll() is None:
            self.up.process.send_signal(signal.SIGCONT)
        self.up.clean_up()


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Callable[..., Lab]]:
    made: list[Lab] = []

    def lab(*options: str) -> Lab:
        made.append(Lab(tmp_path, *options))
        return made[-1]

    yield lab
    for one in made:
        one.clean_up()


def load(api: ApiProcess, key: str) -> httpx.Response | None:
    """Put a plate on a stack, where nothing speaks against another one; None if the process is gone."""
    body = {"station": STACK, "labware": "plate96", "by": "ada"}
    try:
        with api.client() as client:
            return client.post("/stations/load", json=body, headers={"idempotency-key": key})
    except httpx.TransportError:
        return None


def await_answer(api: ApiProcess, key: str) -> httpx.Response:
    """The answer once there is one that says more than to ask again."""

    def ask() -> httpx.Response | None:
        found = load(api, key)
        return found if found is not None and found.status_code != 503 else None

    found: httpx.Response = until(ask, "it is answered in the end")
    return found


def load_all(
    first: Sequence[ApiProcess], again: Sequence[ApiProcess], number: int, disturb: Callable[[int], None]
) -> None:
    """Many loads at once, each with a key of its own, and ``disturb`` told how many were answered; then the
    same once more, at processes that were not asked before. Each is done, and said to be done."""
    answered = threading.Semaphore(0)

    def ask(name: int) -> int:
        answer = load(first[name % len(first)], f"key-{name}")
        answered.release()
        if answer is None:
            return 0
        assert answer.status_code in (201, 503), answer.text
        if answer.status_code == 503:
            assert answer.json()["code"] in ("kernel_away", "store_unavailable", "commit_in_doubt", "fenced")
            assert answer.json()["remedy"]
        return answer.status_code

    def repeat(name: int) -> int:
        found = await_answer(again[name % len(again)], f"key-{name}")
        assert found.status_code == 201, found.text
        return found.status_code

    with ThreadPoolExecutor(8) as pool:
        asking = [pool.submit(ask, name) for name in range(number)]
        for count in range(number):
            answered.acquire()
            disturb(count + 1)
        codes = [one.result() for one in asking]
        again_codes = list(pool.map(repeat, range(number)))
    print(f"{codes.count(201)} done at once, {number - codes.count(201)} in doubt")
    print(f"asked again: {again_codes.count(201)} done, {again_codes.count(409)} had been done")


def test_a_kernel_that_is_killed_in_mid_command(make: Callable[..., Lab]) -> None:
    lab = make()
    lab.start()
    one, two = lab.add("one"), lab.add("two")
    number = 60

    def kill(count: int) -> None:
        if count == 20:
            lab.up.kill()
        if count == number:
            for api in (one, two):  # what is known is still told
                assert httpx.get(f"{api.url}/api/v1/state").status_code == 200
            lab.start()

    load_all((one, two), (two, one), number, kill)
    assert lab.count_loaded() == number
    # One that stands still, and is killed while somebody waits for it.
    assert lab.up.process is not None
    lab.up.process.send_signal(signal.SIGSTOP)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(load, one, "late")
        until(lambda: waiting.running(), "somebody asks")
        time.sleep(0.5)  # so that it waits; were it asked later, it would hear the same
        began = time.monotonic()
        lab.up.kill()
        answer = waiting.result()
    assert answer is not None
    assert (answer.status_code, answer.json()["code"]) == (503, "kernel_away")
    assert "Idempotency-Key" in answer.json()["remedy"]
    print(f"told {time.monotonic() - began:.2f} s after the kill")
    lab.start()
    found = until(
        lambda: (a := load(two, "late")) is not None and a.status_code != 503 and a, "it is answered"
    )
    assert found.status_code == 201
    assert lab.count_loaded() == number + 1
    assert lab.up.interrupt() == 0
    verified = labos("verify", "--home", str(lab.up.home))
    assert verified.returncode == 0, verified.stdout


def test_an_api_process_that_is_killed(make: Callable[..., Lab]) -> None:
    lab = make()
    lab.start()
    one, two = lab.add("one"), lab.add("two")
    number = 40

    def kill(count: int) -> None:
        if count == 10:
            one.kill()

    load_all((one, two), (two,), number, kill)
    assert lab.count_loaded() == number
    one.start()
    with one.client() as client:
        assert len(client.get("/events", params={"type": "station.loaded"}).json()["events"]) == number


def test_an_api_process_on_a_secure_bus(make: Callable[..., Lab]) -> None:
    lab = make("--secure")
    lab.start()
    one = lab.add("web")
    assert (lab.up.home / "pki" / "issued").is_dir()
    answer = until(lambda: (a := load(one, "k")) is not None and a.status_code == 201 and a, "it may ask")
    assert answer.status_code == 201
    assert not (lab.up.home / "api.key").exists(), "a certificate says who it is"
    revoked = labos("pki", "revoke", "web", "--why", "test", "--home", str(lab.up.home))
    assert revoked.returncode == 0, revoked.stderr
    keys = (f"after-{number}" for number in itertools.count())  # the bus is closed to it within two seconds
    until(lambda: (a := load(one, next(keys))) is not None and a.status_code == 503, "it may ask no more")
    assert httpx.get(f"{one.url}/api/v1/runs").status_code == 200, "it may look"
    before = lab.count_loaded()
    again = load(one, "again")
    assert again is not None
    assert (again.status_code, lab.count_loaded()) == (503, before)


@pytest.mark.full
@pytest.mark.postgres
def test_a_standby_takes_over_behind_api_processes(tmp_path: Path, postgres_url: str) -> None:
    pair = Pair(tmp_path, postgres_url, 300.0)
    pair.first.options = pair.second.options = (*pair.first.options, "--no-nodes")
    pair.second.options = (*pair.second.options, "--standby")
    processes: list[ApiProcess] = []
    try:
        cell = tmp_path / "rpl.yaml"
        cell.write_text(CELL)
        pair.start(str(cell))
        for name in ("one", "two"):
            options = ("--home", str(pair.first.home), "--database", postgres_url, "--bus", pair.endpoint)
            processes.append(ApiProcess(tmp_path, name, free_port(), *options).start())
        number = 30

        def kill(count: int) -> None:
            if count == 10:
                pair.first.kill()

        load_all(processes, processes[::-1], number, kill)
        until(pair.second.is_there, "the second kernel answers")
        assert pair.second.types().count("station.loaded") == number
        assert pair.second.interrupt() == 0, pair.second.read_log()
    finally:
        for process in processes:
            process.kill()
        pair.clean_up()


def role_in_docs() -> list[bytes]:
    """What docs/api-processes.md lets an API process do in the database."""
    page = (ROOT / "docs" / "api-processes.md").read_text()
    (text,) = re.findall(r"```sql\n(.*?)```", page, re.DOTALL)
    return [statement.strip().encode() for statement in text.split(";") if statement.strip()]


@pytest.mark.full
@pytest.mark.postgres
def test_a_replica_of_the_log_on_another_computer(
    tmp_path: Path, own_postgres: Callable[[], PostgresServer]
) -> None:
    """Nothing of the lab's folder is at hand: the log is a hot standby's, the bus a secure one."""
    primary = own_postgres()
    url = primary.create_database("lab")
    lab = Lab(tmp_path, "--secure", "--database", url)
    replica = primary.replica()
    api: ApiProcess | None = None
    try:
        lab.start()
        for words in (("user", "add", "ada"), ("pki", "issue", "api", "web")):
            done = labos(*words, "--home", str(lab.up.home))
            assert done.returncode == 0, done.stderr
        with LabClient(home=lab.up.home) as home:
            home.set_password("ada", "correct horse battery")
            token = home.make_token("test", user="ada", scope="admin")["secret"]
        (folder,) = (lab.up.home / "pki" / "issued").glob("*/api.web")
        bus = next(
            line.split()[-1] for line in lab.up.read_log().splitlines() if line.strip().startswith("bus ")
        )
        options = ("--home", str(tmp_path / "elsewhere"), "--bus", bus, "--cert", str(folder))
        with psycopg.connect(url, autocommit=True) as connection:
            for statement in role_in_docs():
                connection.execute(statement)
        mine, copy = (of.replace("labos@", "lab_api@") for of in (url, replica.url_of("lab")))
        alone = labos("api", "--process", "web", "--database", copy, *options)
        assert alone.returncode != 0
        assert "--accounts" in alone.stderr
        both = ("--database", copy, "--accounts", mine)
        api = ApiProcess(tmp_path, "web", free_port(), *options, *both).start()
        with api.client(str(token)) as client:
            for _ in range(20):
                body = {"station": STACK, "labware": "plate96"}
                made = until(
                    lambda: (a := client.post("/stations/load", json=body)).status_code != 503 and a,  # noqa: B023
                    "the kernel has heard of its certificate",
                )
                assert made.status_code == 201, made.text
                position = made.headers["labos-position"]
                seen = client.get("/events", params={"last": 1}, headers={"labos-position": position})
                assert seen.json()["events"][0]["position"] >= int(position)
            signed = client.post("/login", json={"user": "ada", "password": "correct horse battery"})
            assert signed.status_code == 200
            replica.stop()
            assert client.get("/events").status_code == 503
            replica.start()
            until(lambda: client.get("/events").status_code == 200, "the replica is back")
    finally:
        if api is not None:
            api.kill()
        lab.clean_up()
        replica.remove()
