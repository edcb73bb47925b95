"""Queries to the search index. A separate process answers them and updates the index."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import msgspec

from labos.audit.find import LogPlace, SearchQuery, SearchReply, SearchResult
from labos.errors import BadInput, Refused

PROGRAM = "labos.audit.find_process"

GIVE_UP_S = 60.0
"""A query fails after so many seconds."""

MOST_ASKED = 16
"""At most so many queries may wait at the same time."""

LONGEST_LINE = 64 * 1024 * 1024

_encode = msgspec.json.Encoder().encode
_decode = msgspec.json.Decoder(SearchReply).decode


class Finder:
    """Sends queries to the process, which is started with the first one; one query at a time."""

    def __init__(self, database: str, blobs: Path | str, home: Path) -> None:
        self._begin = LogPlace(database, str(blobs), str(home))
        self._process: asyncio.subprocess.Process | None = None
        self._killed: list[asyncio.subprocess.Process] = []
        self._is_closed = False
        self._turn = asyncio.Lock()
        self._asked = 0

    async def find(self, question: SearchQuery) -> SearchResult:
        """Raises BadInput for a query that cannot be answered, Refused if the index cannot be used."""
        if self._asked >= MOST_ASKED:
            raise Refused(
                f"{self._asked} requests to the search index are already waiting.",
                remedy="Ask again when they have been answered.",
            )
        self._asked += 1
        try:
            async with self._turn:
                reply = await self._ask(question)
        finally:
            self._asked -= 1
        if reply.found is not None:
            return reply.found
        assert reply.refusal is not None
        kind = BadInput if reply.refusal.misasked else Refused
        raise kind(reply.refusal.message, remedy=reply.refusal.remedy)

    def close(self) -> None:
        """No further query is answered. ``wait_closed`` waits until the process has ended."""
        self._is_closed = True
        self._kill()

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None and process.returncode is None:
            process.kill()
            self._killed.append(process)

    def _expect_open(self) -> None:
        if self._is_closed:
            self._kill()
            raise Refused("The lab is closing.", remedy="Ask again when it has been started.")

    async def wait_closed(self) -> None:
        """Wait until all killed processes have ended and their pipes are closed."""
        async with self._turn:
            killed, self._killed = self._killed, []
            for process in killed:
                assert process.stdout is not None
                await process.wait()
                await process.stdout.read()

    async def _ask(self, question: SearchQuery) -> SearchReply:
        try:
            async with asyncio.timeout(GIVE_UP_S):
                self._expect_open()
                process = await self._start()
                self._expect_open()
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(_encode(question) + b"\n")
                await process.stdin.drain()
                line = await process.stdout.readline()
        except TimeoutError:
            self._kill()
            raise Refused(
                f"The search took longer than {GIVE_UP_S:g} s and was given up.",
                remedy="Make the search narrower.",
            ) from None
        except OSError:
            line = b""
        except BaseException:
            self._kill()  # else its answer would be taken for the answer to the next query
            raise
        if not line:
            self._kill()
            raise Refused(
                "The process of the search index has ended.",
                remedy="Ask again. `labos audit rebuild` makes the index again.",
            )
        return _decode(line)

    async def _start(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                PROGRAM,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                limit=LONGEST_LINE,
            )
            assert self._process.stdin is not None
            self._process.stdin.write(_encode(self._begin) + b"\n")
        return self._process
