"""Who is refused on a secure bus, and that the same is possible on an open one. One router of each kind, two
labs on them, a node, and a stranger in a process of his own who has a certificate of each sort."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Coroutine, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from labos.bus import Onlooker, Security, Unheard, ZenohBus, open_bus
from labos.bus._opening import config_of
from labos.clock import SystemClock, Uuid7Ids
from labos.errors import BadInput, BusError, NoAnswer
from labos.node import Setup
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import Ask, Keys
from labos.node.server import NodeServer
from labos.pki import Authority, Credentials, PartyIdentity
from labos.settings import free_port
from tests.integration.bus.contract import until
from tests.support.attacked import Device
from tests.support.lab_process import until as wait_until
from tests.support.stranger import ANSWER, Stranger

LAB, OTHER_LAB = "lab-1", "lab-2"
KEYS = Keys(LAB)
SEALER, PEELER = "cell/sealer", "cell/peeler"
BUS, KERNEL = PartyIdentity("bus"), PartyIdentity("kernel", lab=LAB)
NODE = PartyIdentity("node", SEALER, LAB)
STRANGERS = {
    "peeler": PartyIdentity("node", PEELER, LAB),
    "kernel": PartyIdentity("kernel", lab=OTHER_LAB),
    "viewer": PartyIdentity("viewer", "wall", LAB),
    "stop": PartyIdentity("stop", "door", LAB),
    "api": PartyIdentity("api", "web", LAB),
    "nobody": PartyIdentity("node", "cell/away", LAB),
}
"""The stranger's certificates. That of ``nobody`` is valid and was revoked."""


class Site:
    """A bus by itself, secure or open; the kernel of a lab, and the real node of a module, on it."""

    router: ZenohBus
    kernel: ZenohBus
    sealer: NodeServer

    def __init__(self, folder: Path, *, secure: bool) -> None:
        self.folder, self.secure = folder, secure
        self.endpoint = f"{'tls' if secure else 'tcp'}/127.0.0.1:{free_port()}"
        self.authority = Authority(folder / "pki")
        self.runner = asyncio.Runner()
        self.run = self.runner.run
        self.stranger = Stranger()
        self._numbers = itertools.count(1)
        self.heard: list[str] = []
        self.living: set[str] = set()

    def security(self, who: PartyIdentity, *, runs_bus: bool = False) -> Security | None:
        if not self.secure:
            return None
        members = self.authority.read_members().admitted if runs_bus else ()
        return Security(self.authority.credentials(who), members)

    async def open(self) -> None:
        if self.secure:
            self.authority.init("test")
            self.authority.issue(BUS, addresses=["127.0.0.1"])
            for who in (KERNEL, NODE, *STRANGERS.values()):
                self.authority.issue(who)
            self.authority.revoke(self.authority.find("cell/away"), "its computer was stolen")
        self.router = await open_bus(
            mode="router", listen=[self.endpoint], security=self.security(BUS, runs_bus=True)
        )
        self.kernel = await open_bus(connect=[self.endpoint], security=self.security(KERNEL))
        await self.kernel.serve_all(KEYS.all_setups, self._on_setup)
        await self.kernel.serve(KEYS.files, self._on_files)
        await self.kernel.serve_all(KEYS.requests_of("*", 1), self._on_setup)
        await self.kernel.declare_alive(KEYS.kernel)
        for keys in (KEYS.all_states, KEYS.all_results):
            await self.kernel.subscribe(keys, lambda key, _: self.heard.append(key))
        await self.kernel.watch_alive(KEYS.all_alive, self._note)
        await self._start_sealer()
        for name, who in STRANGERS.items():
            folder = str(self.authority.credentials(who).folder) if self.secure else ""
            await asyncio.to_thread(self.stranger, "open", name, self.endpoint, folder)

    async def _start_sealer(self) -> None:
        bus = await open_bus(connect=[self.endpoint], security=self.security(NODE))
        journal = await Journal.open(FileJournalFile(self.folder / "sealer.journal"), Uuid7Ids())
        node = Device(Setup("sealer", "cell"))
        self.sealer = NodeServer(node, bus, LAB, journal, SystemClock(), Uuid7Ids(), heartbeat_s=600.0)
        self.sealer_bus = bus
        await self.sealer.start()
        await until(lambda: KEYS.operation(SEALER, "state") in self.heard)  # which it publishes of itself
        self.heard.clear()

    async def close(self) -> None:
        await self.sealer.close()
        for bus in (self.sealer_bus, self.kernel, self.router):
            await bus.close()

    async def _on_setup(self, key: str, _: bytes) -> bytes:
        return key.encode()

    async def _on_files(self, _: bytes) -> bytes:
        return b"file"

    def _note(self, key: str, living: bool) -> None:
        (self.living.add if living else self.living.discard)(key)

    def does(self, do: str, who: str, *args: Any) -> Any:
        """Let the stranger do something, while the others answer."""
        return self.run(asyncio.to_thread(self.stranger, do, who, *args))

    def hears(self, who: str, keys: str) -> list[str]:
        """What the stranger is told of keys while the kernel and a node say something."""
        self.does("listen", who, keys)
        self.run(self.kernel.publish(KEYS.events("run"), b"{}"))
        self.run(self.sealer._publish_state())
        self.run(settle(self.kernel))
        self.run(settle(self.sealer_bus))
        return list(self.does("list_heard", who))

    def in_order(self) -> None:
        """Until the kernel has heard what the stranger said before."""
        key = KEYS.operation(PEELER, f"result/{next(self._numbers)}")
        self.does("put", "peeler", key, "{}")
        self.run(until(lambda: key in self.heard))


async def settle(bus: ZenohBus) -> None:
    """Until the router has seen what this session declared and published before: Zenoh sends declarations
    before messages, so it takes a round trip of each kind."""
    await bus._round_trip()
    await asyncio.to_thread(lambda: list(bus._session.get("labos/@round-trip", timeout=1.0)))


@pytest.fixture(scope="module", params=[True, False], ids=["secure", "open"])
def site(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    made = Site(tmp_path_factory.mktemp("site"), secure=request.param)
    with ExitStack() as stack:
        stack.callback(made.runner.close)
        stack.callback(made.stranger.close)
        made.run(made.open())
        stack.callback(lambda: made.run(made.close()))
        yield made


@pytest.fixture(autouse=True)
def _rests(site: Site) -> Iterator[None]:
    yield
    for name in STRANGERS:
        site.does("rest", name)
    site.heard.clear()


def test_what_everybody_may_do_for_himself(site: Site) -> None:
    """The kernel asks a node, hears it and sees it live; a node asks the kernel and sees it live."""

    async def answers() -> bytes:
        return await site.kernel.query(KEYS.operation(SEALER, "about"), b"{}", 2.0)

    assert b"cell/sealer" in site.run(answers())
    site.run(site.sealer._publish_state())
    site.run(until(lambda: KEYS.operation(SEALER, "state") in site.heard))
    site.run(until(lambda: KEYS.alive(SEALER, site.sealer.instance) in site.living))
    own = KEYS.setup_of(PEELER)
    assert site.does("get", "peeler", own, "{}") == [own]
    assert site.does("get", "peeler", KEYS.files, "{}") == ["file"]
    site.does("listen", "peeler", "labos/*/@kernel")
    assert site.does("list_heard", "peeler") == [KEYS.kernel]
    site.does("answer", "peeler", KEYS.operation(PEELER, "state"))
    assert site.run(site.kernel.query(KEYS.operation(PEELER, "state"), b"", 2.0)) == ANSWER


@pytest.mark.parametrize("who", STRANGERS)
def test_who_is_admitted_sees_that_the_bus_is_open(site: Site, who: str) -> None:
    """Otherwise it would connect again and again."""
    assert site.does("sees", who, "labos/@round-trip") is (who != "nobody" or not site.secure)


@pytest.mark.parametrize("key", ["cell/away/action", "cell/**", "**"])
@pytest.mark.parametrize("who", ["peeler", "kernel", "viewer", "nobody"])
def test_nobody_answers_for_another_module(site: Site, who: str, key: str) -> None:
    site.does("answer", who, f"{KEYS.root}/{key}" if key != "**" else key)
    asked = site.kernel.query(KEYS.operation("cell/away", "action"), b"", 2.0)
    assert is_refused(site, asked) is site.secure


@pytest.mark.parametrize("who", ["peeler", "kernel", "viewer", "nobody"])
def test_nobody_publishes_for_another_module(site: Site, who: str) -> None:
    forged = [KEYS.operation(SEALER, "state"), KEYS.result(SEALER, "a1")]
    for key in forged:
        site.does("put", who, key, "{}")
    site.in_order()
    assert [key for key in site.heard if key in forged] == ([] if site.secure else forged)


@pytest.mark.parametrize("who", ["peeler", "viewer", "nobody"])
def test_everybody_may_send_a_list_of_members_and_that_allows_nothing_else(site: Site, who: str) -> None:
    """A certificate that is not listed, or was revoked, is heard in this alone: a list says who signed it."""
    lists: list[str] = []
    handle = site.run(site.router.subscribe("labos/@members", lambda key, _: lists.append(key)))
    forged = [KEYS.result(SEALER, f"forged-{who}-{number}") for number in range(20)]
    for key in (*forged, "labos/@members/more", "labos/@members"):
        site.does("put", who, key, "{}")
    site.run(until(lambda: lists == ["labos/@members"]))
    site.in_order()
    assert [key for key in site.heard if key in forged] == ([] if site.secure else forged)
    assert lists == ["labos/@members"]
    handle.close()


@pytest.mark.parametrize("who", ["peeler", "kernel", "viewer", "nobody"])
def test_nobody_shows_the_life_of_another(site: Site, who: str) -> None:
    """Neither that of a module, nor that of the kernel."""
    site.does("token", who, KEYS.alive("cell/away", "forged"))
    site.does("token", who, KEYS.kernel.replace("@kernel", "@name/cell/away/forged/has"))
    site.does("token", "peeler", KEYS.alive(PEELER, "own"))
    site.run(until(lambda: KEYS.alive(PEELER, "own") in site.living))
    assert (KEYS.alive("cell/away", "forged") not in site.living) is site.secure


@pytest.mark.parametrize("who", ["peeler", "kernel", "viewer", "nobody"])
def test_nobody_plays_the_kernel(site: Site, who: str) -> None:
    """A node that starts is not told by somebody else what its module is, nor which kernel lives."""
    site.does("answer", who, KEYS.setup)
    assert is_refused(site, site.sealer_bus.query(KEYS.setup, b"", 2.0)) is site.secure
    seen: list[str] = []
    ours = site.run(site.sealer_bus.watch_alive("labos/*/@kernel", lambda key, _: seen.append(key)))
    site.does("token", who, "labos/lab-3/@kernel")
    site.run(settle(site.sealer_bus))
    assert ("labos/lab-3/@kernel" not in seen) is site.secure
    ours.close()


@pytest.mark.parametrize("who", ["peeler", "kernel", "viewer", "nobody"])
def test_a_kernel_of_a_higher_epoch_that_is_none_is_not_heard(site: Site, who: str) -> None:
    """The node obeys whoever asks in the name of its lab with a greater epoch: on a secure bus only the
    lab's kernel can ask."""
    epoch = site.sealer.journal.memory.epoch
    question = msgspec.json.encode(Ask(LAB, epoch + 5, f"a-{who}", 1, 1, void=True)).decode()
    answered = site.does("get", who, KEYS.operation(SEALER, "action"), question)
    assert (answered == []) is site.secure
    assert site.sealer.journal.memory.epoch == (epoch if site.secure else epoch + 5)


@pytest.mark.parametrize("mode", ["peer", "router"])
def test_another_mode_of_zenoh_helps_nobody(site: Site, mode: str) -> None:
    """A stolen key is not bound to the mode that nodes use."""
    if not site.secure:
        pytest.skip("it needs none")
    folder = str(site.authority.credentials(STRANGERS["peeler"]).folder)
    site.does("open", mode, site.endpoint, folder, mode)
    try:
        site.does("put", mode, KEYS.operation(SEALER, "state"), "{}")
        for key in ("cell/away/action", "**"):
            site.does("answer", mode, f"{KEYS.root}/{key}")
        site.does("token", mode, KEYS.alive("cell/away", mode))
        site.does("token", mode, KEYS.alive(PEELER, mode))
        site.run(until(lambda: KEYS.alive(PEELER, mode) in site.living))
        site.in_order()
        assert KEYS.operation(SEALER, "state") not in site.heard
        assert KEYS.alive("cell/away", mode) not in site.living
        assert is_refused(site, site.kernel.query(KEYS.operation("cell/away", "action"), b"", 2.0))
    finally:
        site.does("close", mode)


@pytest.mark.parametrize("operation", ["about", "state", "admin", "reset", "resources"])
def test_a_node_asks_no_other(site: Site, operation: str) -> None:
    for key in (KEYS.operation(SEALER, operation), KEYS.operation("*/*", operation)):
        answered = site.does("get", "peeler", key, "{}")
        assert (answered == []) is site.secure


@pytest.mark.parametrize(
    "keys", ["**", f"{KEYS.root}/**", KEYS.events("*"), KEYS.all_states, "labos/*/@alive/**"]
)
@pytest.mark.parametrize("who", ["peeler", "kernel", "nobody"])
def test_a_node_listens_to_nobody(site: Site, who: str, keys: str) -> None:
    """Nor does the kernel of another lab."""
    assert (site.hears(who, keys) == []) is site.secure


def test_a_node_is_told_of_its_own_module_only(site: Site) -> None:
    """Secrets may stand in what is told of another one."""
    answered = site.does("get", "peeler", KEYS.setup_of(SEALER), "{}")
    assert (answered == []) is site.secure


def test_a_viewer_hears_everything_of_its_lab_and_says_nothing(site: Site) -> None:
    assert KEYS.operation(SEALER, "state") in site.hears("viewer", f"{KEYS.root}/**")
    assert KEYS.events("run") in site.hears("viewer", KEYS.events("*"))
    assert KEYS.alive(SEALER, site.sealer.instance) in site.hears("viewer", KEYS.all_alive)
    assert (site.does("get", "viewer", KEYS.operation(SEALER, "admin"), "{}") == []) is site.secure


def test_who_may_stop_may_only_stop(site: Site) -> None:
    assert site.does("get", "stop", KEYS.operation(SEALER, "admin"), "{}") != []
    assert (site.does("get", "stop", KEYS.operation(SEALER, "action"), "{}") == []) is site.secure


def test_an_api_process_asks_the_kernel_under_its_own_name_and_nobody_else(site: Site) -> None:
    own, other = KEYS.requests_of("web", 1), KEYS.requests_of("office", 1)
    assert site.does("get", "api", own, "{}") == [own]
    assert (site.does("get", "api", other, "{}") == []) is site.secure
    for operation in ("action", "admin", "state", "reset"):
        assert (site.does("get", "api", KEYS.operation(SEALER, operation), "{}") == []) is site.secure
    assert (site.does("get", "api", KEYS.setup_of(SEALER), "{}") == []) is site.secure
    for who in ("peeler", "kernel", "viewer", "stop", "nobody"):
        assert (site.does("get", who, own, "{}") == []) is site.secure, who


def test_nobody_but_the_kernel_answers_api_processes(site: Site) -> None:
    theirs = KEYS.requests_of("web", 2)
    for who in ("peeler", "kernel", "viewer", "stop"):
        site.does("answer", who, theirs)
    assert (site.does("get", "api", theirs, "{}") == []) is site.secure


def test_the_kernel_of_another_lab_has_its_own_keys(site: Site) -> None:
    """Two labs share a router, and do not meet."""
    theirs = Keys(OTHER_LAB)
    site.does("answer", "kernel", theirs.setup)
    site.does("token", "kernel", theirs.kernel)
    seen: list[str] = []
    watch = site.run(site.sealer_bus.watch_alive("labos/*/@kernel", lambda key, _: seen.append(key)))
    site.run(until(lambda: theirs.kernel in seen))
    watch.close()
    assert is_refused(site, site.sealer_bus.query(theirs.setup, b"", 2.0)) is site.secure
    assert is_refused(site, site.kernel.query(theirs.setup, b"", 2.0)) is site.secure


def test_who_is_connected_and_not_heard_is_told_to_the_operator(site: Site) -> None:
    if not site.secure:
        assert site.router.list_connected() == []
        return
    onlooker = Onlooker(site.router, patience_s=0.0)
    site.run(onlooker.start())
    members = site.authority.read_members()
    admitted = members.admitted
    (revoked,) = [entry.common_name for entry in members.entries if entry.revoked_at]
    site.does("rest", "peeler")
    site.run(settle(site.router))

    async def look() -> Unheard:
        return onlooker.look(admitted)

    unheard = site.run(look())
    assert [entry.identity.name for entry in unheard.silent] == [PEELER]
    assert unheard.unknown == (revoked,)
    site.does("token", "peeler", KEYS.alive(PEELER, "own"))
    site.run(until(lambda: not onlooker.look(admitted).silent))
    onlooker.close()


# -- when certificates change ------------------------------------------------------------------


def test_a_session_that_is_opened_anew_says_and_hears_what_it_did(site: Site) -> None:
    """Nobody is missed who is there again at once: neither a node by its kernel, whose session it is, nor
    both when the bus is opened anew under them."""
    told: list[bool] = []
    watch = site.run(site.kernel.watch_alive(KEYS.all_alive, lambda _, living: told.append(living)))
    for bus, who in ((site.kernel, KERNEL), (site.router, BUS)):
        site.run(bus.reopen(site.security(who, runs_bus=who == BUS)))
        site.run(await_heard_again(site))
    site.run(site.kernel.reopen(site.security(KERNEL)))
    site.run(await_heard_again(site))
    assert told.count(False) <= 1, "only the bus that ended under it"
    watch.close()


def test_a_renewed_certificate_is_used(site: Site) -> None:
    if site.secure:
        before = site.authority.credentials(NODE).certificate.read_bytes()
        site.authority.renew(site.authority.find(SEALER))
        assert site.authority.credentials(NODE).certificate.read_bytes() != before
    site.run(site.sealer_bus.reopen(site.security(NODE)))
    site.run(await_heard_again(site))


def test_a_revoked_certificate_speaks_no_more(site: Site) -> None:
    """As soon as the bus is opened anew without it; the others find their way back."""
    await_connected(site, "viewer")  # an earlier test may have opened the bus anew
    assert site.hears("viewer", KEYS.events("*")) == [KEYS.events("run")]
    site.does("rest", "viewer")
    if site.secure:
        site.authority.revoke(site.authority.find("viewer.wall"), "nobody knows where it is")
    site.run(site.router.reopen(site.security(BUS, runs_bus=True)))
    site.run(await_heard_again(site))
    wait_until(
        lambda: site.does("get", "stop", KEYS.operation(SEALER, "admin"), "{}"), "the stranger is back"
    )
    if not site.secure:
        await_connected(site, "viewer")
    assert (site.hears("viewer", KEYS.events("*")) == []) is site.secure


def await_connected(site: Site, who: str) -> None:
    """The stranger's session has found the bus: Zenoh tries again by itself, after up to some seconds."""
    wait_until(lambda: site.does("sees", who, "labos/@round-trip"), f"{who} is connected")


async def await_heard_again(site: Site) -> None:
    """The kernel asks the node again, and hears it."""
    async with asyncio.timeout(20.0):
        while True:
            try:
                await site.kernel.query(KEYS.operation(SEALER, "state"), b"{}", 1.0)
                break
            except NoAnswer:
                await asyncio.sleep(0.05)
    site.heard.clear()
    await site.sealer._publish_state()
    await until(lambda: KEYS.operation(SEALER, "state") in site.heard)
    await until(lambda: KEYS.alive(SEALER, site.sealer.instance) in site.living)


def is_refused(site: Site, asked: Coroutine[Any, Any, bytes]) -> bool:
    """Whether nobody answered."""

    async def ask() -> bool:
        try:
            await asyncio.wait_for(asked, 10.0)
        except NoAnswer:
            return True
        return False

    return bool(site.run(ask()))


# -- who is not even let in --------------------------------------------------------------------


class Past:
    """A clock that is behind by some seconds."""

    def __init__(self, behind_s: float) -> None:
        self._behind_ns = int(behind_s * 1e9)

    def now_ns(self) -> int:
        return SystemClock().now_ns() - self._behind_ns

    def monotonic(self) -> float:
        return 0.0


def test_who_is_refused_at_the_door(site: Site, tmp_path: Path) -> None:
    if not site.secure:
        pytest.skip("an open bus has no door")
    authority, other = site.authority, Authority(tmp_path / "other")
    other.init("another one")
    stranger = other.issue(PartyIdentity("node", SEALER, LAB))
    past = Authority(authority.folder, Past(10 * 86_400.0))
    expired = past.issue(PartyIdentity("node", "cell/expired", LAB), days=1)
    mixed = tmp_path / "mixed"  # the other authority's certificate, but it believes ours
    mixed.mkdir()
    theirs = other.credentials(stranger.identity)
    for name, source in (("ca.pem", authority.folder / "ca.pem"), ("cert.pem", theirs.certificate)):
        (mixed / name).write_bytes(source.read_bytes())
    (mixed / "key.pem").write_bytes(theirs.key.read_bytes())
    (mixed / "key.pem").chmod(0o600)

    async def main() -> None:
        for folder in (mixed, authority.credentials(expired.identity).folder):
            with pytest.raises(BusError, match="do not accept each other"):
                await open_bus(connect=[site.endpoint], security=Security(Credentials(folder)))
        with pytest.raises(
            BusError, match="do not accept each other"
        ):  # its certificate bears another address
            await open_bus(
                connect=[site.endpoint.replace("127.0.0.1", "localhost")], security=site.security(KERNEL)
            )
        bare = config_of("client", (), (site.endpoint,), None)
        ca = json.dumps(str(authority.folder / "ca.pem"))
        bare.insert_json5("transport/link/tls/root_ca_certificate", ca)
        with pytest.raises(zenoh.ZError):  # no certificate, though it believes the authority
            await asyncio.to_thread(zenoh.open, bare)
        with pytest.raises(BadInput, match="tls/"):
            await open_bus(connect=[site.endpoint])
        with pytest.raises(BusError):
            await open_bus(connect=[site.endpoint.replace("tls/", "tcp/")])

    asyncio.run(main())


def test_a_certificate_that_ends_while_it_is_used(site: Site) -> None:
    """Its connection ends with it, and what it showed is gone."""
    if not site.secure:
        pytest.skip("an open bus asks for no certificate")
    ending = Authority(site.authority.folder, Past(86_400 - 2.0))
    entry = ending.issue(PartyIdentity("node", "cell/ending", LAB), days=1)
    folder = str(site.authority.credentials(entry.identity).folder)
    site.run(site.router.reopen(site.security(BUS, runs_bus=True)))
    site.does("open", "ending", site.endpoint, folder)
    site.does("token", "ending", KEYS.alive("cell/ending", "own"))
    site.run(until(lambda: KEYS.alive("cell/ending", "own") in site.living))
    assert entry.common_name in site.router.list_connected()
    site.run(until(lambda: KEYS.alive("cell/ending", "own") not in site.living))
    assert entry.common_name not in site.router.list_connected()
