"""Finds parties that are connected to a secure bus but denied by its rules: Zenoh reports this to neither
side."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

import msgspec

from labos.bus._zenoh import ZenohBus
from labos.node.protocol import Keys
from labos.pki import CertificateEntry
from labos.ports import Handle

PATIENCE_S = 10.0
"""A starting node asks for its module and checks its name before it shows itself; this may take so long."""


class Unheard(msgspec.Struct, frozen=True):
    """``silent`` are nodes that are connected with a certificate and have not shown themselves. ``unknown``
    are the common names of certificates that have no rights here."""

    silent: tuple[CertificateEntry, ...] = ()
    unknown: tuple[str, ...] = ()


class Onlooker:
    """Checks the parties that are connected to the bus of a session."""

    def __init__(self, bus: ZenohBus, patience_s: float = PATIENCE_S) -> None:
        self._bus, self._patience_s = bus, patience_s
        self._living: set[tuple[str, str]] = set()
        self._since: dict[str, float] = {}
        self._handle: Handle | None = None

    async def start(self) -> None:
        self._handle = await self._bus.watch_alive(Keys("*").all_alive, self._note)

    def close(self) -> None:
        if self._handle is not None:
            self._handle.close()

    def look(self, admitted: Iterable[CertificateEntry]) -> Unheard:
        """The parties that have been connected for ``patience_s`` and are not heard."""
        known = {entry.common_name: entry for entry in admitted}
        now = asyncio.get_running_loop().time()
        here = set(self._bus.list_connected())
        self._since = {name: self._since.get(name, now) for name in here}
        long_here = [name for name, since in self._since.items() if now - since >= self._patience_s]
        return Unheard(
            tuple(known[name] for name in long_here if name in known and not self._is_heard(known[name])),
            tuple(name for name in long_here if name not in known),
        )

    def _is_heard(self, entry: CertificateEntry) -> bool:
        who = entry.identity
        return who.kind != "node" or (who.lab, who.name) in self._living

    def _note(self, key: str, living: bool) -> None:
        who = Keys.lab_of(key), Keys.module_of(key)
        (self._living.add if living else self._living.discard)(who)
