"""A bus with certificates: their owners, and the consequences when they change while the lab runs."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec
import structlog

from labos.bootstrap._members import MembersExchange
from labos.bus import SCHEME, Onlooker, Security, Unheard, ZenohBus
from labos.clock import SystemClock
from labos.core.ids import ModuleName
from labos.errors import BadInput, LabosError, NotFound
from labos.pki import MEMBERS, Authority, Credentials, Members, PartyIdentity, ReceivedList
from labos.settings import Settings, last_kernel

POLL_S = 1.0
"""How often changes of certificates are checked: issued, renewed, revoked (seconds)."""

RENEW_S = 3600.0
LOOK_S = 5.0
"""How often certificates that are due, and nodes that do not answer, are searched (seconds)."""

State = tuple[object, ...]
"""The data with which a session was opened; if they change, it has to be opened again."""

_log = structlog.get_logger(__name__)


class Guard:
    """The certificates of a party that runs a bus, or joins one as a kernel. ``modules`` returns the modules
    whose nodes run here: their certificates are renewed together with its own."""

    def __init__(
        self,
        who: PartyIdentity,
        settings: Settings,
        *,
        runs_bus: bool,
        own: Path | None = None,
        modules: Callable[[], Iterable[str]] = lambda: (),
        note_unheard: Callable[[Unheard], None] = lambda _: None,
    ) -> None:
        self.who, self._settings, self._own = who, settings, own
        self._runs_bus, self._modules, self._note_unheard = runs_bus, modules, note_unheard
        self.authority = Authority(settings.pki)
        self._used: State = ()
        self._reported: set[str] = set()
        self._task: asyncio.Task[None] | None = None
        self._onlooker: Onlooker | None = None
        self._exchange: MembersExchange | None = None

    # -- before the bus is open --------------------------------------------------------------

    def prepare(self, modules: Iterable[str] = ()) -> Security:
        """Its certificate, and those of the nodes that run here; if there is no authority, one is made.
        Blocks. Raises NotFound, Refused, BadInput."""
        if self._own is None:
            self._find_authority()
            self._renew(modules)
        self._used = self._state()  # changes after this point are noticed
        credentials = self.credentials
        credentials.check(SystemClock().now_ns())
        self._check_identity(credentials)
        return self.security()

    @property
    def credentials(self) -> Credentials:
        return Credentials(self._own) if self._own is not None else self.authority.credentials(self.who)

    def security(self) -> Security:
        """Raises NotFound, BadInput."""
        return Security(self.credentials, self.members().admitted if self._runs_bus else ())

    def members(self) -> Members:
        """The parties with access to the bus that it runs. Raises NotFound, BadInput."""
        received = self.received_list
        if received is not None and received.file.is_file():
            return received.read()
        return self.authority.read_members()

    @property
    def received_list(self) -> ReceivedList | None:
        """The list of members if the authority is on another computer."""
        return ReceivedList(self._own) if self._own is not None else None

    def _read_signed_list(self) -> bytes:
        """The list that is published to others. Blocks."""
        file = (self._own or self.authority.folder) / MEMBERS
        if not file.is_file():
            return b""
        members = self.members()  # a list that is not valid here is not sent to others
        return msgspec.json.encode(members) if members.signature else b""

    def find_node_folder(self, module: str) -> Path:
        """The folder of the certificate of a node that runs here."""
        return self.authority.credentials(PartyIdentity("node", module, self.who.lab)).folder

    def issue_for(self, modules: Iterable[str]) -> None:
        """Issue certificates for nodes that run here and have none. Blocks. Raises Refused, BadInput."""
        if self.authority.issues:
            self.authority.issue_all(PartyIdentity("node", module, self.who.lab) for module in modules)

    def _find_authority(self) -> None:
        """The authority. One is made for a lab that never had one and runs its bus itself. Raises
        NotFound."""
        if self.authority.exists:
            return
        if not self._runs_bus:
            raise NotFound(
                f"There is no certificate for the {self.who.shown}, and no authority in "
                f"{self.authority.folder}.",
                remedy="Issue it where the lab's authority is (labos pki issue), copy its folder here, "
                "and name it with --cert; or name the authority's folder with --pki.",
            )
        last = last_kernel(self._settings.home)
        if last is not None and last.bus.startswith(SCHEME):
            raise NotFound(
                f"This lab's bus was secure, but its authority {self.authority.folder} is missing.",
                remedy="Restore it from a copy, or give its folder with --pki. A new authority (labos pki "
                "init) does not accept the existing certificates of nodes.",
            )
        self.authority.init(f"LabOS authority of {socket.gethostname()}"[:64])

    def _renew(self, modules: Iterable[str]) -> None:
        """Renew its own certificate, and those of the nodes that run here. Raises Refused, NotFound,
        BadInput."""
        self.authority.ensure(self.who, addresses=list_addresses(self._settings))
        self.issue_for(modules)

    def _check_identity(self, credentials: Credentials) -> None:
        identity = credentials.identity()
        if identity is not None and identity != self.who:
            raise BadInput(
                f"The certificate in {credentials.folder} is that of the {identity.shown}"
                f"{f' of lab {identity.lab}' if identity.lab else ''}, not of the {self.who.shown}"
                f"{f' of lab {self.who.lab}' if self.who.lab else ''}.",
                remedy="Issue one: labos pki issue.",
            )

    # -- while the bus runs ------------------------------------------------------------------

    async def watch(self, bus: ZenohBus) -> None:
        """Apply all changes from now on."""
        if self._runs_bus:
            self._onlooker = Onlooker(bus)
            await self._onlooker.start()
        self._exchange = MembersExchange(bus, self._read_signed_list, self.received_list)
        await self._exchange.start()
        self._task = asyncio.get_running_loop().create_task(self._watch(bus))

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
        if self._onlooker is not None:
            self._onlooker.close()

    async def _watch(self, bus: ZenohBus) -> None:
        now = asyncio.get_running_loop().time
        renewed = looked = now()
        while True:
            await asyncio.sleep(POLL_S)
            try:
                if self._own is None and now() - renewed >= RENEW_S:
                    renewed = now()
                    await asyncio.to_thread(self._renew, list(self._modules()))
                found = self._state()
                if found != self._used:
                    security = self.security()
                    security.credentials.check(SystemClock().now_ns())
                    _log.warning("bus_reopened", why="certificates have changed")
                    await bus.reopen(security)
                    self._used = found
                if self._exchange is not None:
                    await self._exchange.send()
                if self._onlooker is not None and now() - looked >= LOOK_S:
                    looked = now()
                    self._note(self._onlooker.look(self.members().admitted))
            except LabosError as error:
                _log.warning("certificates_not_heeded", why=str(error))
                await asyncio.sleep(LOOK_S)
            except Exception:  # the next revocation must be applied in any case
                _log.exception("certificates_not_heeded")
                await asyncio.sleep(LOOK_S)

    def _note(self, unheard: Unheard) -> None:
        for entry in unheard.silent:
            if entry.common_name not in self._reported:
                _log.warning("node_connected_but_not_heard", node=entry.identity.name, cn=entry.common_name)
        for name in unheard.unknown:
            if name not in self._reported:
                _log.warning("certificate_not_admitted", cn=name)
        self._reported = {entry.common_name for entry in unheard.silent} | set(unheard.unknown)
        self._note_unheard(unheard)

    def _state(self) -> State:
        """The data with which a session is opened: its certificate, and the rights of all parties."""
        try:
            members = self.members().admitted if self._runs_bus else ()
        except LabosError:
            members = ()
        return (self.credentials.stamp(), {(entry.common_name, entry.identity) for entry in members})


def list_addresses(settings: Settings) -> list[str]:
    """The addresses at which the bus of this computer can be reached."""
    here = {"127.0.0.1", "localhost", socket.gethostname(), *settings.addresses}
    if settings.host not in ("0.0.0.0", "::", ""):
        here.add(settings.host)
    return sorted(here)


def explain_unheard(unheard: Unheard, lab: str) -> dict[ModuleName, str]:
    """A sentence for the operator about each module whose node is connected and does not answer."""
    return {
        ModuleName(
            entry.identity.name
        ): f"its node is connected to the bus with the certificate {entry.common_name}, but it has not "
        "announced itself: does it run as this module? See its log."
        for entry in unheard.silent
        if entry.identity.lab == lab
    }
