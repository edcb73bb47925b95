"""The certificate of a node, on a secure bus."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import structlog

from labos.clock import SystemClock
from labos.errors import BadInput, LabosError, NotFound
from labos.pki import Authority, Credentials, PartyIdentity
from labos.settings import Settings

if TYPE_CHECKING:
    from labos.bus import Security, ZenohBus

POLL_S = 2.0
"""How often a node looks whether its certificate was replaced."""

URGENT_NS = 3600 * 10**9
"""A certificate that ends so soon is not used until the device is at rest."""

_log = structlog.get_logger(__name__)


def read_node_security(
    settings: Settings,
    module: str,
    lab: str,
    endpoints: Sequence[str],
    certificate: Path | None,
    *,
    secure: bool,
) -> tuple[Security | None, str]:
    """The certificate of a node if its bus is a secure one, and the lab that it is for (empty: not known).
    Raises NotFound, BadInput."""
    from labos.bus import SCHEME, Security

    if certificate is None:
        if not secure and not any(endpoint.startswith(SCHEME) for endpoint in endpoints):
            return None, ""
        certificate = _find_own_certificate(settings, module, lab)
    credentials = Credentials(certificate)
    credentials.check(SystemClock().now_ns())
    said = credentials.identity()
    if said is not None and (said.kind, said.name) != ("node", module):
        raise BadInput(
            f"The certificate in {certificate} is that of the {said.shown}, not of the node {module}.",
            remedy="Give the module's own: labos pki list shows them all.",
        )
    return Security(credentials), said.lab if said is not None else ""


def check_lab(module: str, known: str, belongs_to: str) -> None:
    """Whether a certificate is for the lab that the node knows as its own. Raises BadInput: it would not be
    let speak there, and would wait for ever."""
    if belongs_to and known != belongs_to:
        raise BadInput(
            f"The journal of {module} belongs to lab {known}, its certificate to lab {belongs_to}.",
            remedy="Give it the certificate of its lab, or another --home for another lab.",
        )


def _find_own_certificate(settings: Settings, module: str, lab: str) -> Path:
    authority = Authority(settings.pki)
    if not lab:
        raise NotFound(
            "This bus is a secure one, and no certificate was named.",
            remedy="Issue one where the lab's authority is (labos pki issue node WORKCELL/MODULE), copy its "
            "folder here, and name it: --cert FOLDER.",
        )
    return authority.credentials(PartyIdentity("node", module, lab)).folder


async def keep_certificate(bus: ZenohBus, security: Security, is_at_work: Callable[[], bool]) -> None:
    """Replace the present certificate for the rest of the node's life: as soon as the device is at rest, or
    when the present one expires."""
    credentials, clock = security.credentials, SystemClock()
    used, ends = credentials.stamp(), credentials.entry().not_after
    while True:
        await asyncio.sleep(POLL_S)
        found = credentials.stamp()
        if found == used or (is_at_work() and ends - clock.now_ns() > URGENT_NS):
            continue
        try:
            credentials.check(clock.now_ns())
            ends = credentials.entry().not_after
        except LabosError as error:  # half of it is copied, perhaps
            _log.warning("certificate_not_used", why=str(error))
            continue
        await bus.reopen(security)
        used = found
        _log.info("certificate_replaced", until_ns=ends)
