"""Opening a session: Zenoh's settings, and the errors when it fails."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Sequence
from typing import Any, Literal

import zenoh

from labos.bus._security import Security, check_endpoints
from labos.errors import BusError

Mode = Literal["client", "peer", "router"]

LEASE_MS = 2000
"""A frozen process counts as gone after this time."""

RETRY_MS = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}
"""The pauses between the attempts of a client to reach a bus that is gone."""


class Opening:
    """Opens a session, and opens it again."""

    def __init__(self, mode: Mode, listen: tuple[str, ...], connect: tuple[str, ...]) -> None:
        self.mode: Mode = mode
        self._listen, self._connect = listen, connect

    async def open(self, security: Security | None) -> Any:
        """Raises BusError, BadInput."""
        check_endpoints((*self._listen, *self._connect), secure=security is not None)
        config = config_of(self.mode, self._listen, self._connect, security)
        try:
            return await asyncio.to_thread(zenoh.open, config)
        except zenoh.ZError as error:
            raise _explain_failure(
                reason_of(error), self._listen, self._connect, secure=security is not None
            ) from error


def config_of(mode: Mode, listen: Sequence[str], connect: Sequence[str], security: Security | None) -> Any:
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        # Labs find each other only by address, so that two labs on one network are never mixed.
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        # Messages above 3 KB can vanish in shared memory when the receiver stalls.
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        # A party that accepts nothing for this long while others wait for it is frozen too; microseconds.
        "transport/link/tx/queue/congestion_control/block/wait_before_close": LEASE_MS * 1000,
        "connect/retry": RETRY_MS,
        **(security.make_settings(mode) if security is not None else {}),
    }
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise BusError(
                f"The bus cannot use {value!r} as {key}: {reason_of(error)}.",
                remedy="Endpoints read like tcp/127.0.0.1:7447.",
            ) from error
    return config


def _explain_failure(reason: str, listen: Sequence[str], connect: Sequence[str], *, secure: bool) -> BusError:
    where = ", ".join(connect if "connect" in reason else [*listen, *connect])
    if "in use" in reason or "os error 10048" in reason:
        return BusError(
            f"The address {where} of the bus is already in use.",
            remedy="Stop the other process (another `labos up`?) or choose another port.",
        )
    if "nable to connect" in reason and secure:
        return BusError(
            f"Nobody answers at {where}, or the bus there and this certificate do not accept each other.",
            remedy="Are both certificates from one authority and still valid, and does the certificate of "
            "the bus contain this address? See docs/secure-bus.md.",
        )
    if "nable to connect" in reason:
        return BusError(
            f"Nobody answers at {where}.",
            remedy="Start the lab with `labos up`, or check the address and the firewall.",
        )
    return BusError(f"The bus cannot be opened at {where or 'no endpoint'}: {reason}.")


def reason_of(error: Exception) -> str:
    """Zenoh's message, without the places in its source code."""
    text = re.sub(r" at /\S+\.rs:\d+\.?|, location: Some\(Location \{.*?\}\)", "", str(error))
    return text.strip().rstrip(".")
