"""A lab in its own thread, for programs that are not asynchronous."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from types import TracebackType
from typing import Any

import structlog

from labos.bootstrap._lab import Nodes, open_lab
from labos.bootstrap._runtime import LabRuntime
from labos.bootstrap._standby import open_standby
from labos.errors import LabosError, Refused, StoreUnavailable
from labos.runtime.follower import Follower
from labos.settings import Settings
from labos.spec import CompiledWorkcell

_log = structlog.get_logger(__name__)


class LabThread:
    """``open_lab`` as an ordinary context manager; programs use it over HTTP (``url``). With ``standby``, the
    block is entered only when the lab's present kernel is gone and this one has opened the lab. ``standby``
    is called when this one is ready to take over.

    ``failure`` is set when the kernel cannot continue. Leaving the block closes the lab in an orderly way; a
    KeyboardInterrupt during this time, or ``hurry``, makes it close faster.
    """

    def __init__(
        self,
        settings: Settings,
        workcells: Sequence[CompiledWorkcell] = (),
        *,
        nodes: Nodes = "processes",
        detach: bool = False,
        declare: bool | None = None,
        grace_s: float = 30.0,
        standby: Callable[[], None] | None = None,
    ) -> None:
        self.settings = settings
        self.failure: LabosError | None = None
        self.failed = threading.Event()
        self._open_lab = partial(
            open_lab,
            settings,
            workcells=workcells,
            nodes=nodes,
            detach=detach,
            declare=declare,
            grace_s=grace_s,
        )
        self._standby = standby
        self.replaced = ""
        """The kernel that this one has replaced."""
        self._opened, self._ended = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lab: LabRuntime | None = None
        self._end: asyncio.Event | None = None
        self._leaving: asyncio.Task[None] | None = None
        self._is_hurried = False
        self._thread = threading.Thread(target=self._main, name="labos-kernel", daemon=True)

    @property
    def url(self) -> str:
        return self.runtime.http.url

    @property
    def runtime(self) -> LabRuntime:
        """The lab itself. It belongs to the thread's event loop: read only attributes that do not change."""
        assert self._lab is not None
        return self._lab

    @property
    def cut_short(self) -> list[str]:
        """The actions, with their runs, that had not ended when the lab was closed."""
        return self._lab.cut_short if self._lab is not None else []

    def __enter__(self) -> LabThread:
        self._thread.start()
        try:
            while not self._opened.wait(0.2):
                pass
        except BaseException:
            self._stop()
            raise
        if self._error is not None:
            self._thread.join()
            raise self._error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()
        if self._error is not None and error is None:
            raise self._error

    def hurry(self) -> None:
        """Do not wait for actions in progress when the lab is closed; from any thread or signal handler."""
        self._is_hurried = True

    @property
    def left_to_standby(self) -> bool:
        return self._lab is not None and self._lab.left_to_standby

    def leave_to_standby(self) -> None:
        """Close the lab so that a standby can take over, if one is ready; from any thread."""
        self._call_in_loop(self._begin_leaving)

    def _begin_leaving(self) -> None:
        self._leaving = asyncio.get_running_loop().create_task(self._leave_to_standby())

    async def _leave_to_standby(self) -> None:
        if self._lab is None or self._end is None:
            return
        try:
            if await self._lab.leave_to_standby():
                self._end.set()
        except StoreUnavailable as error:
            _log.warning("not_left_to_standby", why=str(error))

    def _stop(self) -> None:
        # Not `join`: if it is interrupted, Python 3.11 takes a living thread for an ended one.
        while not self._ended.is_set():
            try:
                self._call_in_loop(self._begin_end)
                self._ended.wait(0.2)
            except KeyboardInterrupt:
                self.hurry()

    def _begin_end(self) -> None:
        if self._end is not None:
            self._end.set()
        if self._is_hurried and self._lab is not None and self._lab.supervised is not None:
            self._lab.supervised.hurry()

    def _call_in_loop(self, function: Callable[[], object]) -> None:
        if self._loop is not None:
            with suppress(RuntimeError):  # it has ended by itself
                self._loop.call_soon_threadsafe(function)

    def _main(self) -> None:
        try:
            asyncio.run(self._run())
        except BaseException as error:
            self._error = error
        finally:
            self._opened.set()
            self.failed.set()
            self._ended.set()

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        if self._standby is None:
            await self._serve(None)
            return
        async with open_standby(self.settings) as standby:
            while not self._lab:
                self.replaced = await standby.wait(self._end, self._standby)
                if not self.replaced:
                    return
                try:
                    await self._serve(standby.follower)
                except (Refused, StoreUnavailable) as error:
                    # Another standby was faster, or the database is away.
                    if self._lab is not None:
                        raise
                    _log.info("not_taken_over", why=str(error))

    async def _serve(self, follower: Follower | None) -> None:
        assert self._end is not None
        async with self._open_lab(follower=follower) as lab:
            self._lab = lab
            self._opened.set()
            end = asyncio.ensure_future(self._end.wait())
            ends: set[asyncio.Future[Any]] = {end, lab.kernel.failed}
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            end.cancel()
            if lab.kernel.failed.done():
                self.failure = lab.kernel.failed.result()
                self.failed.set()
        if lab.kernel.failed.done():  # perhaps this was only during the closing
            self.failure = lab.kernel.failed.result()
