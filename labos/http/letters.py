"""Messages between an API process and the kernel on the bus.

On a secure bus, a certificate proves who may send requests, and the key expression of a request names the
process. Elsewhere both sides prove that they know the key in the lab's folder; a request is valid for one
minute, and once.
"""

from __future__ import annotations

import hashlib
import hmac
import os
from collections import OrderedDict
from typing import TypeVar

import msgspec

from labos.clock import Clock
from labos.errors import Unreadable
from labos.http.identity import Who
from labos.http.notes import Notes

GOOD_NS = 60 * 10**9
MOST_SEEN = 100_000

Headers = tuple[tuple[bytes, bytes], ...]


class SentOn(msgspec.Struct, frozen=True, tag="request"):
    """A request of a user whom the API process has admitted."""

    method: str
    path: str
    query: bytes
    headers: Headers
    body: bytes
    who: Who
    address: str = ""


class Recall(msgspec.Struct, frozen=True, tag="recall"):
    """Asks for the answer to an earlier request of a user with this idempotency key and this digest."""

    path: str
    key: str
    digest: str
    user: str


class Hello(msgspec.Struct, frozen=True, tag="hello"):
    """An API process reports that it is running, and asks for facts that are not in the log. ``address`` is
    where its metrics are (``host:port``)."""

    address: str


class KernelAnswer(msgspec.Struct, frozen=True, tag="answer"):
    """An answer of the kernel's process; ``status`` 0: there is none. ``position`` is the last position on
    disk in its log."""

    status: int
    headers: Headers = ()
    body: bytes = b""
    position: int = 0


class Welcome(msgspec.Struct, frozen=True, tag="welcome"):
    notes: Notes


LetterRequest = SentOn | Recall | Hello
LetterReply = KernelAnswer | Welcome


class _Sealed(msgspec.Struct, frozen=True):
    """``mac`` is over time, nonce and message; a reply has the nonce of its request."""

    at_ns: int
    nonce: bytes
    mac: bytes
    message: bytes


T = TypeVar("T")
_encode = msgspec.msgpack.Encoder().encode
_sealed = msgspec.msgpack.Decoder(_Sealed)
_question: msgspec.msgpack.Decoder[LetterRequest] = msgspec.msgpack.Decoder(LetterRequest)
_reply: msgspec.msgpack.Decoder[LetterReply] = msgspec.msgpack.Decoder(LetterReply)


class Letters:
    """Seals and opens messages. ``key`` is the one in the lab's folder, empty on a secure bus."""

    def __init__(self, key: bytes, clock: Clock) -> None:
        self._key, self._clock = key, clock
        self._seen: OrderedDict[bytes, int] = OrderedDict()

    def ask(self, question: LetterRequest) -> tuple[bytes, bytes]:
        """A sealed request, and the nonce that its reply must have."""
        nonce = os.urandom(16)
        return self._seal(b"ask", nonce, question), nonce

    def reply(self, nonce: bytes, reply: LetterReply) -> bytes:
        return self._seal(b"reply", nonce, reply)

    def read_question(self, payload: bytes) -> tuple[LetterRequest, bytes]:
        """A request, and its nonce. Raises Unreadable for one whose sender has no right to send it, or that
        was sent before."""
        sealed = self._open(b"ask", payload)
        now = self._clock.now_ns()
        while self._seen and (
            len(self._seen) > MOST_SEEN or now - next(iter(self._seen.values())) > 2 * GOOD_NS
        ):
            self._seen.popitem(last=False)
        if abs(now - sealed.at_ns) > GOOD_NS or sealed.nonce in self._seen:
            raise Unreadable("The question of an API process was asked before, or its clock is wrong.")
        self._seen[sealed.nonce] = now
        return _decode(_question, sealed.message), sealed.nonce

    def read_reply(self, payload: bytes, nonce: bytes) -> LetterReply:
        """Raises Unreadable for a reply that is not the kernel's, or that answers another request."""
        sealed = self._open(b"reply", payload)
        if sealed.nonce != nonce:
            raise Unreadable("The reply answers another question.")
        return _decode(_reply, sealed.message)

    def _seal(self, way: bytes, nonce: bytes, letter: LetterRequest | LetterReply) -> bytes:
        message, at_ns = _encode(letter), self._clock.now_ns()
        return _encode(_Sealed(at_ns, nonce, self._mac(way, at_ns, nonce, message), message))

    def _open(self, way: bytes, payload: bytes) -> _Sealed:
        sealed = _decode(_sealed, payload)
        if not hmac.compare_digest(sealed.mac, self._mac(way, sealed.at_ns, sealed.nonce, sealed.message)):
            raise Unreadable("An API process and the kernel do not have the same key.")
        return sealed

    def _mac(self, way: bytes, at_ns: int, nonce: bytes, message: bytes) -> bytes:
        if not self._key:
            return b""
        whole = b"%b %d %d %b%b" % (way, at_ns, len(nonce), nonce, message)
        return hmac.digest(self._key, whole, hashlib.sha256)


def _decode(decoder: msgspec.msgpack.Decoder[T], data: bytes) -> T:
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise Unreadable(f"A message of an API process or to one cannot be read: {error}.") from None
