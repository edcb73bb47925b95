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
"""How often a node checks whether its certificate was replaced (seconds)."""

URGENT_NS = 3600 * 10**9
"""A new certificate is used when the device is at rest, unless the old one expires within this time (ns)."""

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
    """The certificate of a node if its bus is secure, and the lab for which it is valid (empty: not known).
    Raises NotFound, BadInput."""
    from labos.bus import SCHEME, Security

    if certificate is None:
        if not secure and not any(endpoint.startswith(SCHEME) for endpoint in endpoints):
            return None, ""
        certificate = _find_own_certificate(settings, module, lab)
    credentials = Credentials(certificate)
    credentials.check(SystemClock().now_ns())
    identity = credentials.identity()
    if identity is not None and (identity.kind, identity.name) != ("node", module):
        raise BadInput(
            f"The certificate in {certificate} belongs to the {identity.shown}, not to the node {module}.",
            remedy="Use the module's own certificate: labos pki list shows all.",
        )
    return Security(credentials), identity.lab if identity is not None else ""


def check_lab(module: str, known: str, belongs_to: str) -> None:
    """Check that a certificate is valid for the node's own lab. Raises BadInput: otherwise the bus would
    refuse the node, and it would wait without end."""
    if belongs_to and known != belongs_to:
        raise BadInput(
            f"The journal of {module} belongs to lab {known}, but its certificate to lab {belongs_to}.",
            remedy="Give it the certificate of its lab, or another --home for another lab.",
        )


def _find_own_certificate(settings: Settings, module: str, lab: str) -> Path:
    authority = Authority(settings.pki)
    if not lab:
        raise NotFound(
            "This bus is secure, but no certificate was given.",
            remedy="Issue one where the lab's authority is (labos pki issue node WORKCELL/MODULE), copy its "
            "folder here, and give it: --cert FOLDER.",
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
        except LabosError as error:  # perhaps only a part of it is copied
            _log.warning("certificate_not_used", why=str(error))
            continue
        await bus.reopen(security)
        used = found
        _log.info("certificate_replaced", until_ns=ends)
