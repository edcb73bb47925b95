"""A client whose lab breaks off: how long it goes on asking, over real connections."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import pytest

from labos.client import LabClient, LabUnreachable
from labos.errors import LabosError

HELD_S = 1.2
PATIENCE_S = 1.0
DOUBT = b'{"detail": "The database broke off.", "remedy": "Look.", "code": "commit_in_doubt", "details": []}'
UNAVAILABLE = DOUBT.replace(b"commit_in_doubt", b"store_unavailable")
ANSWER = b'HTTP/1.1 200 OK\r\ncontent-type: application/json\r\ncontent-length: 13\r\n\r\n{"epoch": 23}'


class Lab:
    """Listens, keeps so many callers waiting for a while and breaks off; answers whoever comes then."""

    def __init__(self, breaks: int) -> None:
        self.breaks = breaks
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                caller, _ = self._server.accept()
                with caller:
                    caller.recv(65536)
                    if self.breaks:
                        self.breaks -= 1
                        time.sleep(HELD_S)
                    else:
                        caller.sendall(ANSWER)


@pytest.mark.slow
def test_a_lab_that_keeps_breaking_off_is_not_silent() -> None:
    """Each of two long questions lasts longer than the patience with a silent lab."""
    lab = Lab(2)
    try:
        with LabClient(lab.url, patience_s=PATIENCE_S) as client:
            assert client.health() == {"epoch": 23}
        assert lab.breaks == 0
    finally:
        lab.close()


def test_a_lab_that_is_gone_is_given_up() -> None:
    lab = Lab(0)
    lab.close()
    with LabClient(lab.url, patience_s=PATIENCE_S) as client, pytest.raises(LabUnreachable):
        client.health()


class Refusing(Lab):
    """Answers so many callers that it could not write its log, and why."""

    def __init__(self, breaks: int, why: bytes) -> None:
        self.why, self.asked = why, 0
        super().__init__(breaks)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                caller, _ = self._server.accept()
                with caller:
                    caller.recv(65536)
                    self.asked += 1
                    refused = b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/json\r\n"
                    refused += b"connection: close\r\ncontent-length: %d\r\n\r\n%s" % (
                        len(self.why),
                        self.why,
                    )
                    caller.sendall(refused if self.asked <= self.breaks else ANSWER)


@pytest.mark.parametrize(("why", "asked"), [(DOUBT, 1), (UNAVAILABLE, 3)])
def test_what_may_have_been_done_is_not_asked_for_again(why: bytes, asked: int) -> None:
    """A stack that is filled twice holds what nobody has put there."""
    lab = Refusing(2, why)
    try:
        with LabClient(lab.url, patience_s=20.0) as client:
            if asked == 1:
                with pytest.raises(LabosError, match="The database broke off"):
                    client.unload("tower", "ada")
            else:
                client.unload("tower", "ada")
        assert lab.asked == asked
        lab.asked = 0
        with LabClient(lab.url, patience_s=20.0) as client:
            client.pause("R1")
        assert lab.asked == 3, "what may be done twice is"
    finally:
        lab.close()
