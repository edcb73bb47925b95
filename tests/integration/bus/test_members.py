"""The list of who may speak reaches a bus in another process, which has nothing but its own folder, over the
bus itself; an older or a forged one does not."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from labos.bootstrap import Guard
from labos.bus import MEMBERS as KEY
from labos.bus import Security, ZenohBus, open_bus
from labos.pki import MEMBERS, Authority, Credentials, Members, PartyIdentity, ReceivedList
from labos.settings import Settings, free_port
from tests.support.lab_process import until

pytestmark = pytest.mark.slow

LAB = "lab-1"
BUS, KERNEL = PartyIdentity("bus"), PartyIdentity("kernel", lab=LAB)
NODE, OTHER = PartyIdentity("node", "rpl/sealer", LAB), PartyIdentity("node", "rpl/peeler", LAB)


class Site:
    """An authority, and a bus in a process of its own that has a copy of its folder as it was at first."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.endpoint = folder, f"tls/127.0.0.1:{free_port()}"
        self.settings = Settings.make(folder / "lab", bus=(self.endpoint,), secure=True)
        self.authority = Authority(self.settings.pki)
        self.authority.init("test")
        self.authority.issue(BUS, addresses=["127.0.0.1"])
        self.bus = ReceivedList(folder / "bus")
        shutil.copytree(self.authority.credentials(BUS).folder, self.bus.folder)
        self.log = folder / "bus.log"

    @contextmanager
    def run_node(self) -> Iterator[None]:
        words = ["bus", "--listen", self.endpoint, "--cert", str(self.bus.folder)]
        with self.log.open("ab") as log:
            process = subprocess.Popen([sys.executable, "-m", "labos", *words], stdout=log, stderr=log)
        try:
            yield
        finally:
            process.terminate()
            process.wait(30)

    def present(self) -> Members:
        return msgspec.json.decode(self.bus.file.read_bytes(), type=Members)

    def until_known(self) -> None:
        newest = self.authority.read_members().number
        until(lambda: self.present().number == newest, "the bus has the newest list")


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


async def join(security: Security, site: Site) -> ZenohBus:
    return await open_bus(mode="client", connect=[site.endpoint], security=security)


def test_a_kernel_brings_the_list_in_which_it_stands_and_each_newer_one(site: Site) -> None:
    """Its certificate is issued when the bus has been copied already: it is not let in, but heard in this."""

    async def lead() -> None:
        guard = Guard(KERNEL, site.settings, runs_bus=False)
        security = await asyncio.to_thread(guard.prepare)
        assert site.present().find(KERNEL) is None
        kernel = await join(security, site)
        await guard.watch(kernel)
        try:
            await asyncio.to_thread(site.until_known)
            assert site.present().find(KERNEL) is not None
            await asyncio.to_thread(site.authority.issue, NODE)
            await asyncio.to_thread(site.until_known)
            older = site.authority.members_file.read_bytes()
            await asyncio.to_thread(site.authority.revoke, site.authority.find("rpl/sealer"), "stolen")
            await asyncio.to_thread(site.until_known)
            assert site.present().find(NODE) is None
            # Whoever has the list of before its revocation sends it, and one of his own making.
            forged = msgspec.structs.replace(site.authority.read_members(), number=1_000)
            # Again and again: the bus begins anew when somebody is revoked, and hears nothing meanwhile.
            give_up = time.monotonic() + 60
            while "members_refused" not in site.log.read_text():
                assert time.monotonic() < give_up, "it says so"
                for data in (older, msgspec.json.encode(forged), b"{"):
                    await kernel.publish(KEY, data)
                await asyncio.sleep(0.2)
            await asyncio.to_thread(site.authority.issue, OTHER)
            await asyncio.to_thread(site.until_known)
            assert site.present() == site.authority.read_members()
            assert site.present().find(NODE) is None
        finally:
            await guard.close()
            await kernel.close()

    with site.run_node():
        until(lambda: "The bus runs" in site.log.read_text(), "the bus runs")
        asyncio.run(lead())
    assert "members_received" in site.log.read_text()


def test_a_kernel_elsewhere_has_the_list_from_the_bus(site: Site) -> None:
    """A standby on another computer has the kernel's folder, and no authority."""
    site.authority.issue(KERNEL)
    own = site.folder / "kernel"
    shutil.copytree(site.authority.credentials(KERNEL).folder, own)
    away = Settings.make(site.folder / "away", bus=(site.endpoint,), secure=True)

    async def lead() -> None:
        leads = Guard(KERNEL, site.settings, runs_bus=False)
        stands_by = Guard(KERNEL, away, runs_bus=False, own=own)
        buses = []
        for guard in (leads, stands_by):
            bus = await join(await asyncio.to_thread(guard.prepare), site)
            buses.append(bus)
            await guard.watch(bus)
        try:
            await asyncio.to_thread(site.until_known)
            await asyncio.to_thread(site.authority.issue, NODE)
            newest = site.authority.read_members()
            await asyncio.to_thread(
                until, lambda: ReceivedList(own).read() == newest, "the other kernel has it"
            )
        finally:
            for guard, bus in zip((leads, stands_by), buses, strict=True):
                await guard.close()
                await bus.close()

    with site.run_node():
        until(lambda: "The bus runs" in site.log.read_text(), "the bus runs")
        asyncio.run(lead())


def test_a_node_cannot_send_a_list_and_a_stranger_neither_hears_one(site: Site) -> None:
    """What it sends is not signed; lists are told to kernels only."""
    for who in (KERNEL, NODE):
        site.authority.issue(who)
    shutil.copy(site.authority.members_file, site.bus.folder / MEMBERS)
    evil = Authority(site.folder / "evil")
    evil.init("test")
    for number in range(5):
        evil.issue(PartyIdentity("node", f"rpl/m{number}", LAB))

    async def lead() -> None:
        node = await join(Security(Credentials(site.authority.credentials(NODE).folder)), site)
        heard: list[bytes] = []
        await node.subscribe(KEY, lambda _, data: heard.append(data))
        before = site.present()
        await node.publish(KEY, evil.members_file.read_bytes())
        await asyncio.to_thread(until, lambda: "members_refused" in site.log.read_text(), "it says so")
        assert site.present() == before
        guard = Guard(KERNEL, site.settings, runs_bus=False)
        kernel = await join(await asyncio.to_thread(guard.prepare), site)
        await guard.watch(kernel)
        await asyncio.to_thread(site.authority.issue, OTHER)
        await asyncio.to_thread(site.until_known)
        assert set(heard) == {evil.members_file.read_bytes()}, "its own alone"
        await guard.close()
        for bus in (kernel, node):
            await bus.close()

    with site.run_node():
        until(lambda: "The bus runs" in site.log.read_text(), "the bus runs")
        asyncio.run(lead())


def test_a_bus_does_not_start_with_an_older_list_than_it_had(site: Site) -> None:
    older = site.bus.file.read_bytes()
    site.authority.issue(NODE)
    assert site.bus.offer(site.authority.members_file.read_bytes())
    site.bus.file.write_bytes(older)
    words = ["bus", "--listen", site.endpoint, "--cert", str(site.bus.folder)]
    done = subprocess.run(
        [sys.executable, "-m", "labos", *words], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 1
    assert "was already here: an older list may allow certificates that were revoked later" in done.stderr
