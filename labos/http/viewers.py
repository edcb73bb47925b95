"""A separate process serves the followers of the log; it reads the log by itself.

The kernel's process reads a request and hands over its connection (the socket itself). After that it has no
work with it, so the number of followers and their reading does not slow the kernel down. The process is
started for the first follower, and ends with the kernel.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec
import structlog

from labos.core.envelope import Record
from labos.core.viewer import Viewer
from labos.errors import LabosError
from labos.http.ends import OpenStreams, StreamEnd
from labos.http.tail import PAGE, RETRY, STREAM_HEADERS, STREAM_TYPE, Tail
from labos.ports import LogQuery
from labos.store import open_store

if TYPE_CHECKING:
    from labos.runtime.ledger import Entry

PACKET = 256 * 1024
NOTICE_S = 0.02
"""The pause between two messages to the process that the log has grown."""
STALL_S = 30.0
"""How long a follower may accept nothing."""
RETRY_S = 0.5
HEAD = b"HTTP/1.1 200 OK\r\ncontent-type: %b; charset=utf-8\r\n%bconnection: close\r\n\r\n%b" % (
    STREAM_TYPE.encode(),
    "".join(f"{name}: {value}\r\n" for name, value in STREAM_HEADERS.items()).encode(),
    RETRY,
)

_log = structlog.get_logger(__name__)


class OpenLog(msgspec.Struct, frozen=True):
    """Where the log is. A URL may contain a password, so it is not passed on the command line."""

    database: str
    durable: int


class Grown(msgspec.Struct, frozen=True, tag="grown"):
    durable: int


class Follow(msgspec.Struct, frozen=True, tag="follow"):
    """A follower; its connection comes with the packet. ``key`` identifies its credential (empty: none),
    ``lasts_s`` is how long the credential is valid. ``stored``: events as the log has them. ``viewer``: which
    campaigns it may see."""

    query: LogQuery
    key: str = ""
    lasts_s: float = 0.0
    stored: bool = False
    viewer: Viewer | None = None


class Cut(msgspec.Struct, frozen=True, tag="cut"):
    """The followers with this key must be disconnected."""

    key: str


Message = Grown | Follow | Cut
_encode = msgspec.json.Encoder().encode
_decoder: msgspec.json.Decoder[Message] = msgspec.json.Decoder(Message)


class Viewers:
    """The kernel's side: a listener of the kernel, which hands over connections."""

    def __init__(self, database: str) -> None:
        self._database = database
        self._process: subprocess.Popen[bytes] | None = None
        self._link: socket.socket | None = None
        self._durable = 0
        self._notice: asyncio.TimerHandle | None = None
        self._is_closed = False

    def on_committed(self, entries: Sequence[Entry]) -> None:
        if entries:
            self._durable = entries[-1].position
            if self._link is not None and self._notice is None:
                self._notice = asyncio.get_running_loop().call_later(NOTICE_S, self._send_notice)

    def on_reopened(self) -> None:
        """New events are reported with the next commit."""

    def cut(self, key: str) -> None:
        """End the streams that were opened with this credential."""
        if self._link is None:
            return
        try:
            self._link.send(_encode(Cut(key)))
        except OSError:
            self._end()  # end all streams: the followers connect again if they are allowed to

    def take_over(self, connection: socket.socket, follow: Follow, durable: int) -> bool:
        """Hand over a follower's connection; the caller closes its own end. False if this is not possible
        now."""
        self._durable = max(self._durable, durable)
        if self._is_closed:
            return False
        try:
            link = self._link or self._start()
        except OSError as error:
            _log.warning("viewers_not_started", why=str(error))
            return False
        try:
            os.write(connection.fileno(), HEAD)  # at once: the process may have to start first
        except OSError:
            return True  # the follower has gone
        try:
            socket.send_fds(link, [_encode(follow)], [connection.fileno()])
        except BlockingIOError:
            pass  # many at once while the process starts: this one is disconnected, and connects again
        except OSError as error:
            _log.warning("viewers_failed", why=str(error))
            self._end()
        return True

    def close(self) -> None:
        """The process ends, and its followers' connections too; no further connection is taken over."""
        self._is_closed = True
        self._end()

    def _end(self) -> None:
        if self._notice is not None:
            self._notice.cancel()
            self._notice = None
        if self._link is not None:
            asyncio.get_running_loop().remove_reader(self._link)
            self._link.close()
            self._link = None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _start(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            try:
                self._process = subprocess.Popen(
                    (sys.executable, "-m", "labos.http.viewers", str(theirs.fileno())),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                    pass_fds=(theirs.fileno(),),
                )
            except OSError:
                ours.close()
                raise
        ours.setblocking(False)
        ours.send(_encode(OpenLog(self._database, self._durable)))
        self._link = ours
        asyncio.get_running_loop().add_reader(ours, self._on_end)  # readable only at its end
        return ours

    def _on_end(self) -> None:
        _log.warning("viewers_ended")
        self._end()

    def _send_notice(self) -> None:
        self._notice = None
        if self._link is None:
            return
        try:
            self._link.send(_encode(Grown(self._durable)))
        except BlockingIOError:
            self._notice = asyncio.get_running_loop().call_later(NOTICE_S, self._send_notice)
        except OSError:
            self._end()


class _Server:
    """The other side: reads the log once for all followers, and writes to each."""

    def __init__(self, begin: OpenLog) -> None:
        self.durable = begin.durable
        self.store = open_store(begin.database, create=False, read_only=True)
        self.tail = Tail(self.store, lambda: self._read)
        self._read = begin.durable
        self._grown = asyncio.Event()
        import resource  # not on Windows, where this process is never started

        self._most = resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 2
        """The largest number of followers: the process needs files of its own, and its memory is limited."""
        self._tasks: set[asyncio.Task[None]] = set()
        self._ends = OpenStreams()

    def handle_message(self, message: Message, fds: Sequence[int]) -> None:
        match message:
            case Follow(_, key, lasts_s) if fds:
                if len(self._tasks) >= self._most:
                    os.close(fds[0])
                    return
                # At once: the next message may report its end.
                end = self._ends.begin(key, lasts_s) if key else None
                task = asyncio.get_running_loop().create_task(
                    self._serve(socket.socket(fileno=fds[0]), message, end)
                )
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
            case Cut(key):
                self._ends.cut(key)
            case Grown(durable):
                self.durable = max(self.durable, durable)
                self._grown.set()
            case Follow() | OpenLog():
                pass  # its connection did not come with the packet; the log is open already

    async def keep_up(self) -> None:
        """Read new events and send them, without end."""
        while True:
            await self._grown.wait()
            self._grown.clear()
            while self._read < self.durable:
                upto = min(self.durable, self._read + PAGE)
                try:
                    records = await asyncio.to_thread(self._read_records, self._read, upto)
                except LabosError as error:
                    _log.warning("log_not_read", why=str(error))
                    await asyncio.sleep(RETRY_S)
                    continue
                self._read = records[-1].head.position if records else upto
                self.tail.add(records)

    def _read_records(self, after: int, upto: int) -> list[Record]:
        return list(self.store.read(after, upto))

    async def _serve(self, connection: socket.socket, follow: Follow, end: StreamEnd | None) -> None:
        reader, writer = await asyncio.open_connection(sock=connection)
        me = asyncio.current_task()
        assert me is not None
        gone = asyncio.ensure_future(_await_end(reader))
        gone.add_done_callback(lambda _: me.cancel())
        try:
            async for piece in self.tail.follow(
                follow.query, end, stored=follow.stored, viewer=follow.viewer
            ):
                writer.write(piece)
                await asyncio.wait_for(writer.drain(), STALL_S)
            await asyncio.wait_for(writer.drain(), STALL_S)
            writer.close()
        except (OSError, TimeoutError, LabosError, asyncio.CancelledError):
            writer.transport.abort()
        finally:
            gone.cancel()
            if end is not None:
                self._ends.forget(follow.key, end)


async def _await_end(reader: asyncio.StreamReader) -> None:
    """Wait until a follower has gone; it sends nothing."""
    with contextlib.suppress(OSError):
        while await reader.read(4096):
            pass


async def serve(link: socket.socket) -> None:
    """Serve followers until the kernel closes the link. The first message says where the log is."""
    begin = link.recv(PACKET)
    if not begin:
        return
    server = _Server(msgspec.json.decode(begin, type=OpenLog))
    link.setblocking(False)
    loop = asyncio.get_running_loop()
    over = loop.create_future()

    def receive() -> None:
        while not over.done():
            try:
                packet, fds, _, _ = socket.recv_fds(link, PACKET, 1)
            except BlockingIOError:
                return
            except OSError:
                packet, fds = b"", []
            if packet:
                server.handle_message(_decoder.decode(packet), fds)
            else:
                over.set_result(None)

    loop.add_reader(link, receive)
    receive()
    keeping = loop.create_task(server.keep_up())
    await over
    keeping.cancel()


if __name__ == "__main__":
    asyncio.run(serve(socket.socket(fileno=int(sys.argv[1]))))
