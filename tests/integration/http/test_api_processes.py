"""Two API processes beside a kernel: whoever asks one of them might as well have asked the other."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx
import pytest

from labos.bootstrap import ApiSettings, LabThread
from labos.bus import open_bus
from labos.client import LabClient
from labos.clock import SystemClock
from labos.core.decide.users import DisableUser, EnableUser
from labos.errors import BadInput, BusError, NotFound, Unreadable
from labos.http.identity import Who
from labos.http.letters import Hello, KernelAnswer, Letters, Recall, SentOn, Welcome
from labos.node.protocol import Keys
from labos.services.accounts import Credential
from labos.settings import Settings
from tests.integration.http.signed import PASSWORDS, client_of, execute, lab_with_users, token_of
from tests.integration.http.test_signing import is_problem
from tests.support.api_process import ApiThread
from tests.support.lab_process import until

keys = (f"k{number}" for number in itertools.count())
FLOW = "labos: 1\nname: f\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("api")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    with lab_with_users(folder) as running:
        yield running


@pytest.fixture(scope="module")
def both(lab: LabThread, folder: Path) -> Iterator[Sequence[ApiThread]]:
    home = Settings.make(folder / "lab")
    with ApiThread(ApiSettings(home, "one")) as one, ApiThread(ApiSettings(home, "two")) as two:
        yield one, two


@pytest.fixture(scope="module")
def ada(lab: LabThread, folder: Path) -> str:
    return token_of(folder, "ada", scope="admin")


def count_placed(lab: LabThread) -> int:
    """How many plates people have put on stacks and stations."""
    with LabClient(home=lab.settings.home) as client:
        return sum(event["payload"].get("count", 1) for event in client.events(type="station.loaded"))


def load(client: httpx.Client, key: str = "", count: int = 1) -> httpx.Response:
    headers = {"idempotency-key": key} if key else {}
    body = {"station": "sciclops.tower4", "labware": "plate96", "count": count}
    return client.post("/stations/load", json=body, headers=headers)


# -- exactly once ----------------------------------------------------------------------------------


def test_a_key_at_one_process_is_known_at_the_other(
    lab: LabThread, both: Sequence[ApiThread], ada: str
) -> None:
    key, before = next(keys), count_placed(lab)
    with both[0].client(ada) as one, both[1].client(ada) as two, client_of(lab, ada) as kernel:
        answers = [load(client, key) for client in (one, two, kernel, one)]
        assert {(a.status_code, a.content) for a in answers} == {(201, answers[0].content)}
        is_problem(load(two, key, count=2), 409, "key_reused")
        assert count_placed(lab) == before + 1


def test_a_run_submitted_at_one_process_is_the_same_run_at_the_other(
    both: Sequence[ApiThread], ada: str
) -> None:
    body = {"workflow": {"text": FLOW}, "payload": {}}
    headers = {"idempotency-key": next(keys)}
    with both[0].client(ada, **headers) as one, both[1].client(ada, **headers) as two:
        first, second = one.post("/runs", json=body), two.post("/runs", json=body)
        assert first.status_code == 201
        assert second.content == first.content
        is_problem(two.post("/runs", json={**body, "priority": 3}), 409, "key_reused")
        several = {"workflow": {"text": FLOW}, "payloads": [{}, {}], "keys": [next(keys), next(keys)]}
        together = one.post("/runs/batch", json=several, headers={"idempotency-key": next(keys)})
        assert together.status_code == 201
        again = two.post("/runs/batch", json=several, headers={"idempotency-key": next(keys)})
        assert again.json()["runs"] == together.json()["runs"]


def test_a_repeated_request_is_answered_though_it_would_be_refused_now(
    both: Sequence[ApiThread], ada: str
) -> None:
    body = {"group": next(keys)}
    headers = {"idempotency-key": next(keys)}
    with both[0].client(ada) as one, both[1].client(ada) as two:
        first = one.post("/groups", json=body, headers=headers)
        assert first.status_code in (200, 201), first.text
        is_problem(two.post("/groups", json=body), 409, "refused")
        assert two.post("/groups", json=body, headers=headers).content == first.content


def test_what_is_refused_does_not_reach_the_kernel(
    lab: LabThread, both: Sequence[ApiThread], ada: str
) -> None:
    kernel = lab.runtime.kernel
    with both[0].client(ada) as one:
        load(one)
        turns = kernel.turns
        answered = both[0].runtime.link.work.by_kernel
        for _ in range(20):
            is_problem(one.post("/runs/R999/cancel", json={}), 404, "not_found")
            assert one.post("/runs", json={"workflow": {"text": "labos: 1"}}).status_code == 422
            assert one.get("/state").status_code == 200
        assert both[0].runtime.link.work.by_kernel == answered
        assert kernel.turns - turns < 20, "only what the kernel does by itself"


def test_a_restarted_kernel_does_nothing_twice(tmp_path: Path) -> None:
    """Its memory is gone, and the log bears the request's mark."""
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    key = next(keys)
    with lab_with_users(tmp_path) as lab, client_of(lab, token_of(tmp_path, "ada", scope="admin")) as client:
        first = load(client, key)
        assert first.status_code == 201
        assert load(client, key).content == first.content
        assert count_placed(lab) == 1
    with LabThread(settings, nodes="none") as lab, ApiThread(ApiSettings(settings)) as api:
        token = token_of(tmp_path, "ada", scope="admin")
        for there in (api.client(token), client_of(lab, token)):
            with there as client:
                again = load(client, key)
                assert (again.status_code, again.content) == (201, first.content), again.text
                is_problem(load(client, key, count=2), 409, "key_reused")
        with api.client(token) as client:
            assert load(client, next(keys)).status_code == 201
        assert count_placed(lab) == 2


def test_what_was_answered_is_answered_again_while_the_kernel_is_away(tmp_path: Path) -> None:
    """Also what would be refused by now, as a booking that is there, or a user who has been added."""
    asked = {
        "/bookings": {"target": "hidex", "begins_at": 4 * 10**18, "ends_at": 4 * 10**18 + 3600 * 10**9},
        "/users": {"user": "cy", "kind": "person", "role": "viewer"},
        "/groups": {"group": "chemistry"},
        "/control/pause": {"target": "sealer", "why": "lunch"},
        "/runs": {"workflow": {"text": FLOW}},
        "/experiments": {"name": "e"},
    }

    def ask(client: httpx.Client) -> list[httpx.Response]:
        return [
            client.post(path, json=body, headers={"idempotency-key": f"mine {path}"})
            for path, body in asked.items()
        ]

    with contextlib.ExitStack() as stack:
        with lab_with_users(tmp_path) as lab:
            ada = token_of(tmp_path, "ada", scope="admin")
            api = stack.enter_context(ApiThread(ApiSettings(lab.settings)))
            with client_of(lab, ada) as kernel:
                first = ask(kernel)
                assert {answer.status_code for answer in first} <= {200, 201}, [a.text for a in first]
            with api.client(ada) as client:
                assert [answer.content for answer in ask(client)] == [answer.content for answer in first]
        with api.client(ada) as client:
            for answer, was in zip(ask(client), first, strict=True):
                assert (answer.status_code, answer.content) == (was.status_code, was.content), answer.text
            new = client.post("/groups", json={"group": "new"}, headers={"idempotency-key": "other"})
            is_problem(new, 503, "kernel_away")
            body = asked["/bookings"] | {"why": "another"}
            other = client.post("/bookings", json=body, headers={"idempotency-key": "mine /bookings"})
            is_problem(other, 409, "key_reused")


# -- what is seen ----------------------------------------------------------------------------------


def test_who_has_written_reads_it_everywhere(both: Sequence[ApiThread], ada: str) -> None:
    with both[0].client(ada) as one, both[1].client(ada) as two:
        for _ in range(10):
            name = next(keys)
            made = one.post("/groups", json={"group": name})
            assert name in {group["name"] for group in one.get("/groups").json()["groups"]}
            position = made.headers["labos-position"]
            seen = two.get("/groups", headers={"labos-position": position})
            assert name in {group["name"] for group in seen.json()["groups"]}
            assert int(seen.headers["labos-position"]) >= int(position)
        told = is_problem(two.get("/groups", headers={"labos-position": "999999999"}), 503, "behind")
        assert "999999999" in told["detail"]
        is_problem(two.get("/groups", headers={"labos-position": "x"}), 400, "bad_input")


def test_the_state_is_the_kernels_own(lab: LabThread, both: Sequence[ApiThread], ada: str) -> None:
    with both[0].client(ada) as one, client_of(lab, ada) as kernel:
        until(lambda: both[0].runtime.simulated, "the kernel has said what the log does not")
        mine, theirs = one.get("/state").json(), kernel.get("/state").json()
        for changing in ("now", "position"):
            mine.pop(changing), theirs.pop(changing)
        assert mine == theirs


def test_events_are_followed_and_gone_on_with(both: Sequence[ApiThread], ada: str) -> None:
    with both[0].client(ada) as one, both[1].client(ada) as two:
        position = int(load(one).headers["labos-position"])
        for client in (one, two):
            headers = {"last-event-id": str(position)}
            with client.stream("GET", "/events/stream", params={"after": 0}, headers=headers) as stream:
                lines = stream.iter_lines()
                assert next(lines).startswith("retry")
                load(one)
                ids = (int(line[4:]) for line in lines if line.startswith("id: "))
                assert next(ids) == position + 1
            position = int(load(two).headers["labos-position"])


# -- who asks --------------------------------------------------------------------------------------


def test_signed_in_at_one_is_signed_in_at_the_other(both: Sequence[ApiThread]) -> None:
    with both[0].client(origin=both[0].url) as one, both[1].client(origin=both[1].url) as two:
        shown = {"user": "bob", "password": PASSWORDS["bob"]}
        assert one.post("/login", json=shown).status_code == 200
        two.cookies.update(one.cookies)
        assert two.get("/whoami").json()["user"] == "bob"
        assert two.post("/runs", json={"workflow": {"text": FLOW}}).status_code == 201
        two.headers.pop("origin")
        is_problem(two.post("/runs", json={"workflow": {"text": FLOW}}), 403, "forbidden")
        foreign = two.post("/runs", json={}, headers={"origin": "https://elsewhere.example"})
        is_problem(foreign, 403, "forbidden")
        with two.stream("GET", "/events/stream", params={"after": 0}) as stream:
            lines = stream.iter_lines()
            next(lines)
            assert one.post("/logout", json={}).status_code == 200
            for _ in lines:  # it ends, although it was another process that took the session back
                pass
        until(lambda: two.get("/whoami").status_code == 401, "the session has ended there, too")


def test_rights_are_those_of_the_kernel(lab: LabThread, both: Sequence[ApiThread], folder: Path) -> None:
    with both[0].client(token_of(folder, "bob")) as bob:
        is_problem(bob.post("/groups", json={"group": "mine"}), 403, "forbidden")
        execute(lab, DisableUser("bob"), "ada")
        try:
            is_problem(bob.get("/state"), 401, "not_signed_in")
        finally:
            execute(lab, EnableUser("bob"), "ada")


def test_a_program_acts_for_somebody(lab: LabThread, both: Sequence[ApiThread], folder: Path) -> None:
    token = token_of(folder, "agent")
    with both[0].client(token, **{"labos-on-behalf-of": "bob"}) as agent:
        position = agent.post("/runs", json={"workflow": {"text": FLOW}}).headers["labos-position"]
        query = {"last": 50, "type": "run.submitted", "upto": position}
        event = agent.get("/events", params=query).json()["events"][-1]
        assert event["actor"] == "agent for bob"
    with both[0].client(token, **{"labos-on-behalf-of": "nobody"}) as agent:
        is_problem(agent.get("/state"), 403, "forbidden")


def test_the_key_of_the_folder_is_the_kernels_alone(lab: LabThread, both: Sequence[ApiThread]) -> None:
    with both[0].client(lab.settings.home_key.read_text().strip()) as owner:
        is_problem(owner.get("/state"), 401, "not_signed_in")


def test_a_signature_is_made_at_any_process_and_its_password_stays_there(
    lab: LabThread, both: Sequence[ApiThread], ada: str
) -> None:
    """Somebody else on the bus, who is asked along with the kernel, hears the request without it."""

    async def listen(run: str) -> tuple[list[bytes], list[httpx.Response]]:
        heard: list[bytes] = []

        async def hear(key: str, payload: bytes) -> bytes:
            heard.append(payload)
            await asyncio.sleep(30)  # the kernel is the first who answers
            return b""

        bus = await open_bus(connect=[lab.runtime.bus_endpoint])
        try:
            await bus.serve_all(Keys(lab.runtime.kernel.lab).requests_of("*", lab.runtime.kernel.epoch), hear)
            signed = [
                await asyncio.to_thread(sign, run, password) for password in ("a guess", PASSWORDS["ada"])
            ]
            return heard, signed
        finally:
            await bus.close()

    def sign(run: str, password: str) -> httpx.Response:
        with both[0].client(ada) as one:
            return one.post(f"/runs/{run}/signatures", json={"meaning": "reviewed", "password": password})

    with both[0].client(ada) as one:
        run = one.post("/runs", json={"workflow": {"text": FLOW}, "payload": {}}).json()["run"]
        assert one.post(f"/runs/{run}/cancel", json={}).status_code == 200
    heard, (wrong, signed) = asyncio.run(listen(run))
    is_problem(wrong, 403, "forbidden")
    assert (signed.status_code, signed.json()["by"]) == (200, "ada"), signed.text
    assert any(b"/signatures" in payload for payload in heard)
    assert not any(password.encode() in payload for payload in heard for password in PASSWORDS.values())
    with both[1].client(ada) as two:
        found = two.get(f"/runs/{run}/signatures").json()["signatures"]
        assert [(each["meaning"], each["holds"]) for each in found] == [("reviewed", True)]


def test_metrics_of_each_process_are_found(lab: LabThread, both: Sequence[ApiThread], ada: str) -> None:
    shown = {"authorization": f"Bearer {ada}"}

    def processes() -> set[str]:
        found = httpx.get(f"{lab.url}/metrics/targets", headers=shown).json()
        return {one["targets"][0] for one in found if one["labels"]["process"] == "api"}

    addresses = {api.url.removeprefix("http://") for api in both}
    until(lambda: processes() >= addresses, "the kernel knows of both")
    text = httpx.get(f"{both[1].url}/metrics", headers=shown).text
    assert 'api="two"' in text
    assert "labos_api_kernel_available 1.0" in text
    assert httpx.get(f"{both[1].url}/metrics").status_code == 401
    assert httpx.get(f"{both[1].url}/health").json() == {"status": "ok"}


# -- whom the kernel believes ----------------------------------------------------------------------

ADMIN = Who("token", "ada", credential=Credential("ada", "token", "admin", "k", 2**62, "t"))
STOP = SentOn("POST", "/api/v1/groups", b"", ((b"content-type", b"application/json"),), b"{}", ADMIN)


async def ask_as_stranger(lab: LabThread, payloads: Sequence[bytes], epoch: int = 0) -> list[bytes | None]:
    """What the kernel answers to a stranger on the bus; None for nothing."""
    bus = await open_bus(connect=[lab.runtime.bus_endpoint])
    key = Keys(lab.runtime.kernel.lab).requests_of("one", epoch or lab.runtime.kernel.epoch)
    found: list[bytes | None] = []
    try:
        for payload in payloads:
            try:
                found.append(await bus.query(key, payload, 5.0))
            except BusError:
                found.append(None)
    finally:
        await bus.close()
    return found


def test_a_stranger_on_the_bus_is_not_believed(lab: LabThread) -> None:
    without = [Letters(key, SystemClock()).ask(STOP)[0] for key in (b"", b"x" * 40)]
    assert asyncio.run(ask_as_stranger(lab, [*without, b"", b"\x93", b"x" * 10_000])) == [None] * 5


def test_a_question_is_good_once_and_for_its_kernel(lab: LabThread) -> None:
    letters = Letters(lab.settings.api_key.read_bytes().strip(), SystemClock())
    payload, nonce = letters.ask(Hello(""))
    first, again = asyncio.run(ask_as_stranger(lab, [payload, payload]))
    assert isinstance(letters.read_reply(first or b"", nonce), Welcome)
    assert again is None
    assert asyncio.run(ask_as_stranger(lab, [letters.ask(Hello(""))[0]], epoch=99)) == [None]
    with pytest.raises(Unreadable):
        letters.read_reply(first or b"", b"another")


@pytest.mark.parametrize(
    "who",
    [
        Who("home"),
        Who("open"),
        Who("token", "ada"),
        Who("token", "mallory", credential=Credential("mallory", "token", "admin", "k", 2**62, "t")),
        Who("token", "ada", credential=Credential("bob", "token", "admin", "k", 2**62, "t")),
        Who("token", "ada", "bob", Credential("ada", "token", "admin", "k", 2**62, "t")),
        Who("token", "ada", credential=Credential("ada", "token", "viewer", "k", 2**62, "t")),
    ],
)
def test_even_with_the_key_only_users_of_the_lab_may_act(lab: LabThread, who: Who) -> None:
    letters = Letters(lab.settings.api_key.read_bytes().strip(), SystemClock())
    payload, nonce = letters.ask(
        SentOn(STOP.method, STOP.path, b"", STOP.headers, json.dumps({"group": "evil"}).encode(), who)
    )
    (answer,) = asyncio.run(ask_as_stranger(lab, [payload]))
    reply = letters.read_reply(answer or b"", nonce)
    assert isinstance(reply, KernelAnswer)
    assert reply.status in (401, 403), reply.body
    assert "evil" not in lab.runtime.kernel.state.shares.groups


@pytest.mark.parametrize("path", ["/metrics", "/api/v1/events/stream", "/login/oidc", "/"])
def test_nothing_but_operations_is_carried_out_for_others(lab: LabThread, path: str) -> None:
    letters = Letters(lab.settings.api_key.read_bytes().strip(), SystemClock())
    payload, nonce = letters.ask(SentOn("GET", path, b"", (), b"", ADMIN))
    (answer,) = asyncio.run(ask_as_stranger(lab, [payload]))
    reply = letters.read_reply(answer or b"", nonce)
    assert isinstance(reply, KernelAnswer)
    assert reply.status == 503
    payload, nonce = letters.ask(Recall("/api/v1/groups", "never", "", "ada"))
    (answer,) = asyncio.run(ask_as_stranger(lab, [payload]))
    assert letters.read_reply(answer or b"", nonce) == KernelAnswer(0)


# -- what it cannot serve --------------------------------------------------------------------------


def test_an_api_process_says_what_it_misses(lab: LabThread, folder: Path, tmp_path: Path) -> None:
    home = Settings.make(folder / "lab")
    for settings, error, words in (
        (ApiSettings(home, "One/two"), BadInput, "name of an API process"),
        (ApiSettings(Settings.make(folder / "lab", host="0.0.0.0")), BadInput, "unencrypted"),
        (ApiSettings(Settings.make(tmp_path / "none")), NotFound, "No kernel runs"),
    ):
        with pytest.raises(error, match=words), ApiThread(settings):
            pass
    elsewhere = Settings.make(tmp_path, home.database, bus=(lab.runtime.bus_endpoint,))
    with pytest.raises(NotFound, match="key of API processes"), ApiThread(ApiSettings(elsewhere)):
        pass


def test_nothing_is_written_to_the_log_by_it(both: Sequence[ApiThread]) -> None:
    with pytest.raises(Exception, match="for reading only"):
        both[0].runtime.store.renew(1, 1.0)
    connection = sqlite3.connect(f"file:{both[0].runtime.settings.lab.home}/labos.db?mode=ro", uri=True)
    assert connection.execute("SELECT count(*) FROM account_session").fetchone()[0] >= 0
    connection.close()
