"""Who is let in: without, with expired, revoked and too narrow credentials; what a cookie is not good for."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread
from labos.client import LabClient
from labos.client._lab import API
from labos.core.decide.users import AddUser, DisableUser, EnableUser, GrantRole
from labos.errors import LabosError, NotSignedIn
from labos.http.operation import Operation
from labos.http.routes import OPERATIONS
from labos.services.accounts.tries import OF_ADDRESS, OF_ALL, OF_USER, WITHIN_S, Tries
from labos.settings import Settings
from tests.integration.http.signed import PASSWORDS, client_of, execute, lab_with_users, token_of
from tests.support.lab_process import until


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("signed")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    with lab_with_users(folder) as running:
        yield running


@pytest.fixture(autouse=True)
def fresh_tries(lab: LabThread) -> None:
    gate_of(lab).accounts._tries = Tries()


def gate_of(lab: LabThread) -> Any:
    """The door of a lab, which its application has in its routes."""
    return lab.runtime.gate


def is_problem(answer: httpx.Response, status: int, code: str) -> dict[str, Any]:
    told: dict[str, Any] = answer.json()
    assert (answer.status_code, told["code"]) == (status, code), told
    assert told["remedy"]
    return told


def path_of(operation: Operation) -> str:
    return operation.path.replace("{sha256}", "0" * 64).replace("{", "").replace("}", "")


@contextmanager
def sign_in(lab: LabThread, user: str = "ada") -> Iterator[httpx.Client]:
    """A browser of somebody who has signed in."""
    with client_of(lab, origin=lab.url) as browser:
        answer = browser.post("/login", json={"user": user, "password": PASSWORDS[user]})
        assert answer.status_code == 200, answer.text
        yield browser


# -- every route -----------------------------------------------------------------------------------


@pytest.mark.parametrize("operation", OPERATIONS, ids=[f"{o.method} {o.path}" for o in OPERATIONS])
def test_no_route_answers_who_shows_nothing(lab: LabThread, operation: Operation) -> None:
    with client_of(lab) as stranger:
        body: dict[str, Any] = {"json": {}} if operation.method == "POST" else {}
        answer = stranger.request(operation.method, path_of(operation), **body)
        if operation.needs == "nobody":
            is_problem(answer, 400, "bad_input")
            return
        is_problem(answer, 401, "not_signed_in")
        assert answer.headers["www-authenticate"] == 'Bearer realm="LabOS"'


@pytest.mark.parametrize("path", [f"{API}/openapi.json", "/metrics", "/metrics/targets"])
def test_nothing_else_answers_either(lab: LabThread, folder: Path, path: str) -> None:
    assert httpx.get(lab.url + path).status_code == 401
    token = token_of(folder, "bob", scope="viewer")
    assert httpx.get(lab.url + path, headers={"authorization": f"Bearer {token}"}).status_code == 200
    assert httpx.get(f"{lab.url}/health").json() == {"status": "ok"}


@pytest.mark.parametrize("operation", OPERATIONS, ids=[f"{o.method} {o.path}" for o in OPERATIONS])
def test_a_token_is_good_for_no_more_than_its_scope(
    lab: LabThread, folder: Path, operation: Operation
) -> None:
    if operation.needs in ("viewer", "nobody"):
        return
    with client_of(lab, token_of(folder, "ada", scope="viewer")) as viewer:
        told = is_problem(viewer.post(path_of(operation), json={}), 403, "forbidden")
        assert f"needs {operation.needs}" in told["detail"]


# -- tokens ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "shown", ["Basic YWRhOnB3", "Bearer", "Bearer x", "Bearer labos_token_x", "Bearer labos_home_x", "labos"]
)
def test_what_is_no_token_is_refused(lab: LabThread, shown: str) -> None:
    with client_of(lab, authorization=shown) as stranger:
        is_problem(stranger.get("/state"), 401, "not_signed_in")


def test_a_session_is_no_token_and_a_token_no_cookie(lab: LabThread, folder: Path) -> None:
    with sign_in(lab) as browser:
        cookie = browser.cookies["labos-session"]
    with client_of(lab, cookie) as program:
        is_problem(program.get("/state"), 401, "not_signed_in")
    with client_of(lab) as browser:
        browser.cookies.set("labos-session", token_of(folder, "ada"))
        is_problem(browser.get("/state"), 401, "not_signed_in")


def test_a_token_expires_and_is_revoked(
    lab: LabThread, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with client_of(lab, token_of(folder, "bob", days=1.0)) as program:
        mine = program.get("/tokens").json()["tokens"][-1]
        assert (mine["user"], mine["scope"], mine["revoked_at"]) == ("bob", "submitter", 0)
        until(lambda: program.get("/tokens").json()["tokens"][-1]["used_at"], "its use is noted")
        now = lab.runtime.kernel.clock.now_ns()
        clock = Later(lab.runtime.kernel.clock, 86_400 * 1_000_000_000 + 1)
        monkeypatch.setattr(gate_of(lab).accounts, "_clock", clock)
        told = is_problem(program.get("/state"), 401, "not_signed_in")
        assert "expired" in told["detail"]
        monkeypatch.undo()
        assert now < mine["expires_at"]
        assert program.get("/whoami").json()["user"] == "bob"
        assert program.post(f"/tokens/{mine['id']}/revoke", json={}).status_code == 200
        told = is_problem(program.get("/state"), 401, "not_signed_in")
        assert "revoked" in told["detail"]


class Later:
    """The clock of a later time."""

    def __init__(self, clock: Any, by_ns: int) -> None:
        self._clock, self._by = clock, by_ns

    def now_ns(self) -> int:
        return int(self._clock.now_ns()) + self._by

    def monotonic(self) -> float:
        return float(self._clock.monotonic())


def test_tokens_of_others_are_not_seen_nor_revoked(lab: LabThread, folder: Path) -> None:
    with client_of(lab, token_of(folder, "ada", scope="admin")) as ada:
        hers = ada.get("/tokens").json()["tokens"][-1]["id"]
        with client_of(lab, token_of(folder, "bob", scope="admin")) as bob:
            is_problem(bob.get("/tokens", params={"user": "ada"}), 403, "forbidden")
            is_problem(bob.post(f"/tokens/{hers}/revoke", json={}), 404, "not_found")
            is_problem(bob.post("/tokens", json={"user": "ada"}), 403, "forbidden")
        assert ada.get("/whoami").json()["user"] == "ada"
        assert ada.post("/tokens", json={"user": "agent"}).status_code == 201


def test_a_token_makes_none_that_is_better(lab: LabThread, folder: Path) -> None:
    with client_of(lab, token_of(folder, "ada", scope="submitter", days=2.0)) as program:
        is_problem(program.post("/tokens", json={"scope": "admin"}), 403, "forbidden")
        made = program.post("/tokens", json={"days": 300}).json()["token"]
        own = next(t for t in program.get("/tokens").json()["tokens"] if t["label"] == "test")
        assert made["expires_at"] - own["created_at"] <= 2.1 * 86_400 * 1_000_000_000


def test_only_digests_are_kept(lab: LabThread, folder: Path) -> None:
    token = token_of(folder, "bob")
    with sign_in(lab) as browser:
        cookie = browser.cookies["labos-session"]
    with sqlite3.connect(folder / "lab" / "labos.db") as database:
        dump = "\n".join(database.iterdump())
    assert token not in dump
    assert cookie not in dump
    assert PASSWORDS["bob"] not in dump
    assert "$argon2id$v=19$m=65536,t=3,p=4$" in dump


# -- passwords -------------------------------------------------------------------------------------


def test_wrong_passwords_are_refused_alike_and_counted(lab: LabThread) -> None:
    before = count_refused(lab, "wrong")
    with client_of(lab) as stranger:
        told = [
            is_problem(stranger.post("/login", json=body), 401, "not_signed_in")["detail"]
            for body in (
                {"user": "ada", "password": "wrong"},
                {"user": "nobody", "password": "wrong"},
                {"user": "agent", "password": ""},
            )
        ]
    assert len(set(told)) == 1
    assert count_refused(lab, "wrong") == before + 3


def count_refused(lab: LabThread, outcome: str) -> float:
    return float(lab.runtime.metrics.all.signing.tries.value((outcome,)))


@pytest.mark.slow
def test_too_many_tries_are_not_even_looked_at(lab: LabThread, monkeypatch: pytest.MonkeyPatch) -> None:
    hashed: list[str] = []
    passwords = gate_of(lab).accounts._passwords
    compare = passwords._compare

    def count(hash_: str, password: str) -> bool:
        hashed.append(password)
        return bool(compare(hash_, password))

    monkeypatch.setattr(passwords, "_compare", count)
    with client_of(lab) as stranger:
        for _ in range(OF_USER):
            is_problem(stranger.post("/login", json={"user": "bob", "password": "x"}), 401, "not_signed_in")
        right = {"user": "bob", "password": PASSWORDS["bob"]}
        answer = stranger.post("/login", json=right)
        is_problem(answer, 429, "too_many_tries")
        assert 0 < int(answer.headers["retry-after"]) <= WITHIN_S
        assert len(hashed) == OF_USER
        assert stranger.post("/login", json={"user": "ada", "password": PASSWORDS["ada"]}).status_code == 200
    with LabClient(lab.url) as client, pytest.raises(LabosError, match="too many"):
        client.sign_in("bob", PASSWORDS["bob"])


def test_tries_are_counted_for_a_minute() -> None:
    tries = Tries()
    assert [tries.wait_s("ada", "a", 0.0) for _ in range(OF_USER)] == [0.0] * OF_USER
    assert tries.wait_s("ada", "a", 1.0) == pytest.approx(WITHIN_S - 1)
    assert tries.wait_s("ada", "b", 1.0) == 0.0, "somebody else's address"
    assert tries.wait_s("ada", "a", WITHIN_S + 0.1) == 0.0
    tries = Tries()
    asked = [tries.wait_s(f"user{n}", "a", 0.0) for n in range(OF_ADDRESS + 1)]
    assert asked[-1] > 0 == max(asked[:-1])
    asked = [tries.wait_s(f"user{n}", f"b{n}", 0.0) for n in range(OF_ALL)]
    assert asked[OF_ALL - OF_ADDRESS - 1] == 0 < asked[OF_ALL - OF_ADDRESS]


@pytest.mark.slow
def test_a_password_is_changed_by_who_knows_it(lab: LabThread, folder: Path) -> None:
    with sign_in(lab, "bob") as browser, client_of(lab, token_of(folder, "bob")) as program:
        path, new = "/users/bob/password", {"password": "another four words", "present": "wrong"}
        is_problem(browser.post(path, json=new), 403, "forbidden")
        is_problem(browser.post("/users/ada/password", json=new), 403, "forbidden")
        is_problem(browser.post(path, json={"password": "short", "present": ""}), 403, "forbidden")
        too_short = {"password": "short", "present": PASSWORDS["bob"]}
        is_problem(browser.post(path, json=too_short), 400, "bad_input")
        new["present"] = PASSWORDS["bob"]
        gate_of(lab).accounts._tries = Tries()
        assert browser.post(path, json=new).status_code == 200
        is_problem(browser.get("/state"), 401, "not_signed_in")  # all sessions are over
        assert program.get("/state").status_code == 200
    with LabClient(home=folder / "lab") as home:
        home.set_password("bob", PASSWORDS["bob"])


# -- browsers --------------------------------------------------------------------------------------


def test_a_cookie_is_kept_from_scripts_and_from_other_sites(lab: LabThread) -> None:
    with client_of(lab) as browser:
        answer = browser.post("/login", json={"user": "ada", "password": PASSWORDS["ada"]})
        said = answer.headers["set-cookie"].lower()
        assert "httponly" in said
        assert "samesite=strict" in said
        assert "path=/" in said
        assert "domain" not in said
        assert answer.headers["cache-control"] == "no-store"


def test_a_cookie_is_good_for_own_pages_only(lab: LabThread) -> None:
    with sign_in(lab) as browser:
        assert browser.get("/whoami").json()["how"] == "session"
        assert browser.post("/tokens", json={}).status_code == 201
        del browser.headers["origin"]
        assert browser.get("/state").status_code == 200
        told = is_problem(browser.post("/tokens", json={}), 403, "forbidden")
        assert "names its page" in told["detail"]
        own = {"sec-fetch-site": "same-origin"}
        assert browser.post("/tokens", json={}, headers=own).status_code == 201
        for foreign in (
            {"origin": "https://evil.example"},
            {"origin": "null"},
            {"sec-fetch-site": "same-site"},
        ):
            is_problem(browser.post("/tokens", json={}, headers=foreign), 403, "forbidden")
            is_problem(browser.get("/state", headers=foreign), 403, "forbidden")
        rebound = {"host": "evil.example", "origin": "http://evil.example"}
        is_problem(browser.get("/state", headers=rebound), 403, "forbidden")
        form = browser.post("/tokens", data={"label": "x"})
        is_problem(form, 415, "unsupported_media_type")


def test_a_session_is_never_one_that_somebody_else_chose(lab: LabThread) -> None:
    with client_of(lab, origin=lab.url) as browser:
        browser.cookies.set("labos-session", "labos_session_chosen-by-somebody-else")
        is_problem(browser.get("/state"), 401, "not_signed_in")
        answer = browser.post("/login", json={"user": "ada", "password": PASSWORDS["ada"]})
        first = answer.cookies["labos-session"]
        assert first != "labos_session_chosen-by-somebody-else"
    with client_of(lab, origin=lab.url, cookie=f"labos-session={first}") as browser:
        answer = browser.post("/login", json={"user": "ada", "password": PASSWORDS["ada"]})
        assert answer.cookies["labos-session"] != first
        is_problem(browser.get("/state"), 401, "not_signed_in")  # the one before has ended


def test_who_has_signed_out_is_out(lab: LabThread) -> None:
    with sign_in(lab) as browser:
        cookie = browser.cookies["labos-session"]
        assert browser.post("/logout", json={}).status_code == 200
        assert "labos-session" not in browser.cookies
        browser.cookies.set("labos-session", cookie)
        is_problem(browser.get("/state"), 401, "not_signed_in")


# -- streams ---------------------------------------------------------------------------------------


class Following:
    """A follower of the log, in a thread of its own."""

    def __init__(self, client: httpx.Client) -> None:
        self.began, self.over = threading.Event(), threading.Event()
        self._client = client
        threading.Thread(target=self._follow, daemon=True).start()

    def _follow(self) -> None:
        try:
            with self._client.stream("GET", "/events/stream") as answer:
                assert answer.status_code == 200
                for _ in answer.iter_lines():
                    self.began.set()
        except httpx.HTTPError:
            pass
        self.over.set()


@pytest.mark.slow
@pytest.mark.parametrize("handed_over", [True, False])
def test_a_stream_ends_with_what_opened_it(lab: LabThread, folder: Path, handed_over: bool) -> None:
    viewers = lab.runtime.service.viewers
    if not handed_over:
        lab.runtime.service.viewers = None
    try:
        with sign_in(lab, "bob") as browser, client_of(lab, token_of(folder, "bob")) as program:
            by_cookie, by_token = Following(browser), Following(program)
            assert by_cookie.began.wait(20)
            assert by_token.began.wait(20)
            assert browser.post("/logout", json={}).status_code == 200
            assert by_cookie.over.wait(20)
            assert not by_token.over.is_set()
            execute(lab, DisableUser("bob"), "ada")
            assert by_token.over.wait(20)
            told = is_problem(program.get("/state"), 401, "not_signed_in")
            assert "disabled" in told["detail"]
    finally:
        lab.runtime.service.viewers = viewers
        execute(lab, EnableUser("bob"), "ada")


@pytest.mark.slow
@pytest.mark.parametrize("handed_over", [True, False])
def test_a_stream_ends_when_its_token_expires(lab: LabThread, folder: Path, handed_over: bool) -> None:
    viewers = lab.runtime.service.viewers
    if not handed_over:
        lab.runtime.service.viewers = None
    try:
        with client_of(lab, token_of(folder, "bob", days=1.5 / 86_400)) as program:
            following = Following(program)
            assert following.began.wait(20)
            assert following.over.wait(20)
    finally:
        lab.runtime.service.viewers = viewers


# -- who it was ------------------------------------------------------------------------------------


def test_the_actor_is_who_has_signed_in(lab: LabThread, folder: Path) -> None:
    after = lab.runtime.kernel.durable
    body = {"target": "lab", "by": "bob", "why": "x"}
    with client_of(lab, token_of(folder, "ada", scope="operator"), **{"labos-user": "bob"}) as ada:
        assert ada.post("/control/pause", json=body).status_code == 200
        assert ada.post("/control/resume", json={"target": "lab"}).status_code == 200
    with client_of(lab, token_of(folder, "bob", scope="viewer")) as viewer:
        events = viewer.get("/events", params={"after": after}).json()["events"]
    assert {event["actor"] for event in events} == {"ada"}
    assert all(event["payload"].get("by", "ada") == "ada" for event in events)


def test_only_a_service_account_acts_for_others(lab: LabThread, folder: Path) -> None:
    behalf = {"labos-on-behalf-of": "bob"}
    with client_of(lab, token_of(folder, "ada"), **behalf) as ada:
        assert "not a service account" in is_problem(ada.get("/whoami"), 403, "forbidden")["detail"]
    token = token_of(folder, "agent")
    with client_of(lab, token, **{"labos-on-behalf-of": "nobody"}) as agent:
        is_problem(agent.get("/whoami"), 403, "forbidden")
    after = lab.runtime.kernel.durable
    with LabClient(lab.url, token=token, behalf="bob") as client:
        client.start_experiment("for bob", "somebody else")
        event = next(e for e in client.events(after) if e["type"] == "experiment.started")
    assert (event["actor"], event["payload"]["user"]) == ("agent for bob", "bob")


def test_the_owner_of_the_folder_looks_and_helps(lab: LabThread, folder: Path) -> None:
    with LabClient(home=folder / "lab") as home:
        assert home.identity()["how"] == "home"
        assert home.state()["modules"]
        assert "silent" in home.emergency_stop("sealer", "whoever")
        with pytest.raises(NotSignedIn, match="key in the lab's folder"):
            home.pause("R1")
    key = folder / "lab" / "home.key"
    assert key.stat().st_mode & 0o777 == 0o600


def test_a_key_belongs_to_whoever_uses_it(lab: LabThread, folder: Path) -> None:
    same = {"idempotency-key": "k1"}
    with client_of(lab, token_of(folder, "ada", scope="admin")) as ada:
        mine = ada.post("/experiments", json={"name": "hers"}, headers=same)
        assert mine.status_code == 201
    with client_of(lab, token_of(folder, "bob")) as bob:
        answer = bob.post("/control/pause", json={"target": "E1"}, headers=same)
        assert mine.text not in answer.text


# -- people ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_whoever_is_erased_is_gone_and_events_remain(tmp_path: Path) -> None:
    with lab_with_users(tmp_path) as lab:
        token = token_of(tmp_path, "bob")
        with client_of(lab, token) as bob, client_of(lab, token_of(tmp_path, "ada", scope="admin")) as ada:
            person = {"name": "Robert Unmistakable", "mail": "bob@unmistakable.example"}
            assert bob.post("/users/bob/person", json=person).status_code == 200
            is_problem(bob.post("/users/ada/person", json=person), 403, "forbidden")
            assert bob.post("/experiments", json={"name": "mine"}).status_code == 201
            assert ada.get("/people").json()["people"] == [{"user": "bob", **person}]
            with client_of(lab, token_of(tmp_path, "agent")) as agent:
                is_problem(agent.post("/users/bob/erase", json={}), 403, "forbidden")
            assert ada.get("/events", params={"type": "user.erased"}).json()["events"] == []
            assert ada.post("/users/bob/erase", json={}).status_code == 200
            assert ada.get("/people").json()["people"] == []
            is_problem(bob.get("/state"), 401, "not_signed_in")
            events = ada.get("/events", params={"actor": "bob"}).json()["events"]
            assert events
            told = ada.get("/events", params={"type": "user.erased"}).json()["events"]
            assert [(each["actor"], each["payload"]) for each in told] == [("ada", {"user": "bob"})]
            with LabClient(home=tmp_path / "lab") as home:  # whose owner has no name
                home.erase_person("ada")
            store = lab.runtime.kernel.state.users
            assert store.get("ada") is not None, "they are users as before"
        with LabClient(home=tmp_path / "lab") as home:
            told = list(home.events(type="user.erased"))
        assert [(each["actor"], each["payload"]["user"]) for each in told] == [
            ("ada", "bob"),
            ("labos", "ada"),
        ]
    for file in (tmp_path / "lab").rglob("*"):
        if file.is_file():
            assert b"nmistakable" not in file.read_bytes(), file


@pytest.mark.slow
def test_the_first_user_is_added_by_the_owner_of_the_folder(tmp_path: Path) -> None:
    with LabThread(Settings.make(tmp_path / "lab", simulate=True), nodes="none") as lab:
        with client_of(lab) as anybody:
            body = {"user": "eve", "by": "eve"}
            assert (
                "labos user add eve"
                in is_problem(anybody.post("/users", json=body), 403, "forbidden")["remedy"]
            )
        with LabClient(home=tmp_path / "lab") as home:
            home.add_user("ada", "whoever")
            assert home.identity()["how"] == "home"
    password = tmp_path / "password"
    password.write_text("four words of hers\n")
    first = {"first_user": "ada", "first_password": str(password)}
    with LabThread(Settings.make(tmp_path / "lab", **first), nodes="none") as lab, client_of(lab) as ada:
        body = {"user": "ada", "password": "four words of hers"}
        assert ada.post("/login", json=body).status_code == 200


def test_without_users_everybody_is_who_they_say(tmp_path: Path) -> None:
    with (
        LabThread(Settings.make(tmp_path / "lab", simulate=True), nodes="none") as lab,
        client_of(lab) as anybody,
    ):
        assert anybody.get("/whoami").json()["how"] == "open"
        answer = anybody.post("/login", json={"user": "ada", "password": "x"})
        is_problem(answer, 409, "refused")
        is_problem(anybody.post("/control/pause", json={"target": "lab"}), 400, "bad_input")
        assert anybody.post("/control/pause", json={"target": "lab", "by": "ada"}).status_code == 200


def test_a_program_gets_at_how_nobody_else_signs_in(lab: LabThread, folder: Path) -> None:
    """Not as an admin either: it could approve what it has asked for, or act as another program."""
    execute(lab, AddUser("steward", "service"), "ada")
    execute(lab, GrantRole("user:steward", "admin"), "ada")
    theirs = token_of(folder, "agent")
    with client_of(lab, token_of(folder, "steward", scope="admin")) as program:
        mine = program.post("/tokens", json={"label": "mine", "scope": "viewer", "days": 1})
        assert mine.status_code == 201, mine.text
        for user in ("ada", "bob", "agent"):
            for answer in (
                program.post("/tokens", json={"label": "x", "user": user, "scope": "viewer", "days": 1}),
                program.post(f"/users/{user}/password", json={"password": "a new one of many words"}),
                program.post(f"/users/{user}/identity", json={"issuer": "https://idp", "subject": "me"}),
                program.post(f"/users/{user}/person", json={"mail": "me@example.org"}),
                program.post(f"/users/{user}/erase", json={}),
            ):
                detail = is_problem(answer, 403, "forbidden")["detail"]
                assert detail.startswith("steward is a service account"), detail
            for token in program.get("/tokens", params={"user": user}).json()["tokens"]:
                is_problem(program.post(f"/tokens/{token['id']}/revoke", json={}), 404, "not_found")
        own = program.post("/users/steward/person", json={"name": "The steward"})
        assert own.status_code == 200, own.text
        revoked = program.post(f"/tokens/{mine.json()['token']['id']}/revoke", json={})
        assert revoked.status_code == 200, revoked.text
    with client_of(lab, theirs) as agent:
        assert agent.get("/whoami").json()["user"] == "agent"
