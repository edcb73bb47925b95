"""A process that has loaded everything that a node needs, and starts nodes by forking.

Fourteen nodes that each start an interpreter and load the same modules keep a small machine busy for seconds.
The server loads the modules once; a fork of it is a node after some milliseconds, and shares the memory. It
runs no threads and controls no device; it only forks and reports how its children ended (decision 32). The
kernel's part is ``spawning.ForkServer``; the two communicate over a socket pair, one packet for each message.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import socket
import sys

import msgspec

PACKET = 65536


class StartChild(msgspec.Struct, tag="start"):
    """Become the program with these arguments; the packet also has the descriptors of its standard input and
    of its log."""

    words: tuple[str, ...]


class ChildStarted(msgspec.Struct, tag="started"):
    """A child with this process id runs, for the oldest ``StartChild`` without an answer. If ``pid`` is 0,
    ``why`` is the reason of the failure."""

    pid: int
    why: str = ""


class ChildEnded(msgspec.Struct, tag="ended"):
    """A child ended, with the code that ``subprocess`` would return: negative for a signal."""

    pid: int
    code: int


Answer = ChildStarted | ChildEnded


def serve(link: socket.socket) -> tuple[str, ...] | None:
    """Fork at the kernel's request. Returns the arguments in each child, which continues with them as its
    own, and None in the server when the link is closed."""
    gc.collect()
    gc.freeze()  # the modules loaded now stay shared: the garbage collector leaves them alone
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    while True:
        ready, _, _ = select.select([link.fileno(), woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            _report_ended_children(link)
        if link.fileno() in ready:
            try:
                packet, fds, _, _ = socket.recv_fds(link, PACKET, 2)
            except ConnectionResetError:  # the kernel was killed before it had read an answer
                return None
            if not packet:
                return None
            words = msgspec.json.decode(packet, type=StartChild).words
            try:
                pid = os.fork()
            except OSError as error:
                _send_answer(link, ChildStarted(0, str(error)))
            else:
                if pid == 0:
                    signal.set_wakeup_fd(-1)
                    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                    os.close(woken)
                    os.close(wake)
                    link.close()
                    _set_up_process(words, *fds)
                    return words
                _send_answer(link, ChildStarted(pid))
            for fd in fds:
                os.close(fd)


def _report_ended_children(link: socket.socket) -> None:
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        _send_answer(link, ChildEnded(pid, os.waitstatus_to_exitcode(status)))


def _send_answer(link: socket.socket, answer: Answer) -> None:
    with contextlib.suppress(OSError):  # the kernel has gone: the next read from the link shows it
        link.send(msgspec.json.encode(answer))


def _set_up_process(words: tuple[str, ...], stdin: int, log: int) -> None:
    """Give the process what a separate program would have: a session, its standard files, its name."""
    from setproctitle import setproctitle

    os.setsid()  # a Ctrl-C in the terminal is meant for the kernel, which stops its nodes
    os.dup2(stdin, 0)
    os.dup2(log, 1)
    os.dup2(log, 2)
    for fd in (stdin, log):
        if fd > 2:
            os.close(fd)
    sys.argv = ["labos", *words]
    setproctitle(" ".join(("labos", *words)))
