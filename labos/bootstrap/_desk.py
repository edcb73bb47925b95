"""The services of the kernel's process for API processes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

from labos.bootstrap._gate import end_streams
from labos.errors import NotFound
from labos.http.desk import Desk
from labos.http.letters import Letters
from labos.node.protocol import Keys
from labos.private import create_file
from labos.services.accounts import make_secret
from labos.settings import Settings

if TYPE_CHECKING:
    from labos.bootstrap._runtime import LabRuntime

PREFIX = "labos_api_"


@asynccontextmanager
async def serve_api_processes(settings: Settings, lab: LabRuntime) -> AsyncIterator[None]:
    """Answer API processes as long as the block lasts."""
    key = b"" if settings.is_secure else make_api_key(settings)
    lab.desk = Desk(lab.http.app, lab.service, Letters(key, lab.kernel.clock))
    keys = Keys(lab.kernel.lab).requests_of("*", lab.kernel.epoch)
    handle = await lab.bus.serve_all(keys, lab.desk.on_question)
    ending = asyncio.get_running_loop().create_task(end_streams(lab.http.app.state.api))
    try:
        yield
    finally:
        ending.cancel()
        handle.close()


def make_api_key(settings: Settings) -> bytes:
    """The key by which API processes of this computer authenticate; made once. Raises OSError."""
    with suppress(FileExistsError), create_file(settings.api_key, exclusive=True) as file:
        file.write(f"{make_secret(PREFIX)}\n".encode())
    return read_api_key(settings)


def read_api_key(settings: Settings) -> bytes:
    """Raises NotFound."""
    try:
        found, why = settings.api_key.read_bytes().strip(), " is empty"
    except OSError as error:
        found, why = b"", f": {error.strerror}"
    if not found:
        raise NotFound(
            f"The key of API processes, {settings.api_key}{why}.",
            remedy="Name the --home of the lab on this computer, after its kernel has run there; from "
            "another computer the bus has to be a secure one (--cert FOLDER, docs/secure-bus.md).",
        )
    return found
