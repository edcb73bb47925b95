"""Devices that answer HTTP, with httpx. It is imported when a device is opened, because a simulated device
has no wire."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from labos.errors import Garbled, HalfReply, LinkLost, NoReply, NotConnected
from labos.link.life import Life
from labos.link.scripted import ScriptedHttp
from labos.link.transcript import note

if TYPE_CHECKING:
    import httpx


class HttpReply:
    """The answer of the device, with any status."""

    def __init__(self, status: int, body: bytes, headers: Mapping[str, str], link: str) -> None:
        self.status, self.body, self.headers = status, body, headers
        self._link = link

    @property
    def ok(self) -> bool:
        return 200 <= self.status < 300

    def json(self) -> Any:
        """The body read as JSON. Raises Garbled."""
        try:
            return json.loads(self.body)
        except ValueError as error:
            raise Garbled(
                f"{self._link} sent an answer that is not JSON: {self.body[:80]!r}.",
                remedy="Check the address, and the version of the device's software.",
            ) from error


class HttpLink(Life):
    """A device at a base URL. Each answer comes on the connection of its request. So answers cannot be
    confused, and a stop does not wait for the end of a long request. No request is sent twice, and no
    redirect is followed. ``script`` answers instead of a server.
    """

    def __init__(
        self,
        url: str,
        *,
        name: str = "",
        headers: Mapping[str, str] | None = None,
        identify: Callable[[HttpLink], str] | None = None,
        expected: str = "",
        verify: bool = True,
        script: ScriptedHttp | None = None,
    ) -> None:
        super().__init__(name or f"http {url}", identify, expected)
        self._url, self._headers, self._verify, self._script = url, dict(headers or {}), verify, script
        self._client: httpx.Client | None = None
        self._asking: Counter[httpx.Client] = Counter()

    def exchange(
        self,
        method: str,
        path: str,
        *,
        json: Any = None,
        params: Mapping[str, Any] | None = None,
        content: bytes | None = None,
        files: Mapping[str, Any] | Sequence[tuple[str, Any]] | None = None,
        form: Mapping[str, str] | None = None,
        timeout_s: float = 10.0,
    ) -> HttpReply:
        """Send a request and wait for the whole answer; ``form`` are the fields that are sent with ``files``.
        Raises NotConnected (nothing was sent), LinkLost, NoReply, HalfReply, Garbled."""
        with self._in_use() as client:
            request = client.build_request(
                method,
                path,
                json=json,
                params=params,
                content=content,
                files=files,
                data=form or None,
                timeout=timeout_s,
            )
            with self._judge():
                return self._ask(client, request, timeout_s)

    def get(self, path: str, *, timeout_s: float = 10.0, **more: Any) -> HttpReply:
        return self.exchange("GET", path, timeout_s=timeout_s, **more)

    def post(self, path: str, *, timeout_s: float = 10.0, **more: Any) -> HttpReply:
        return self.exchange("POST", path, timeout_s=timeout_s, **more)

    def _connect(self) -> None:
        import httpx

        # HTTP connects for each request; without a request, being open has no further meaning.
        transport = httpx.MockTransport(self._answer_from_script) if self._script is not None else None
        self._client = httpx.Client(
            base_url=self._url, headers=self._headers, verify=self._verify, transport=transport
        )

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None and not self._asking[client]:
            client.close()

    @contextmanager
    def _in_use(self) -> Iterator[httpx.Client]:
        """The client. It stays open as long as a request waits for an answer, even if the link is closed."""
        with self._lock:
            if not self._is_open:
                self.open()
            assert self._client is not None
            client = self._client
            self._asking[client] += 1
        try:
            yield client
        finally:
            with self._lock:
                self._asking[client] -= 1
                if not self._asking[client]:
                    del self._asking[client]
                    if client is not self._client:
                        client.close()

    def _ask(self, client: httpx.Client, request: httpx.Request, timeout_s: float) -> HttpReply:
        import httpx

        deadline = time.monotonic() + timeout_s
        note(self.name, ">", _question(request))
        begun = False
        try:
            with self._translate():
                response = client.send(request, stream=True)
                try:
                    begun = True
                    body = b""
                    for chunk in response.iter_bytes():
                        body += chunk
                        if time.monotonic() > deadline:
                            raise httpx.ReadTimeout("the answer takes too long", request=request)
                finally:
                    response.close()
        except NoReply as error:
            asked = f"{request.method} {request.url.path}"
            error.message = f"{self.name} does not answer {asked} within {timeout_s:g} s."
            if begun:
                raise HalfReply(f"{self.name} did not finish its answer.") from error
            raise
        except LinkLost as error:
            if begun:
                raise HalfReply(
                    f"{self.name} stopped in the middle of its answer: {error.message}"
                ) from error
            raise
        note(self.name, "<", f"{response.status_code}\n".encode() + body)
        return HttpReply(response.status_code, body, dict(response.headers), self.name)

    def _answer_from_script(self, request: httpx.Request) -> httpx.Response:
        import httpx

        assert self._script is not None
        answer = self._script.answer(_question(request))
        if answer is None:
            raise httpx.ReadTimeout("the transcript has no answer", request=request)
        status, _, body = answer.partition(b"\n")
        return httpx.Response(int(status), content=body)

    @contextmanager
    def _translate(self) -> Iterator[None]:
        """The only place where errors of httpx are translated."""
        import httpx

        try:
            yield
        except (httpx.ConnectError, httpx.ConnectTimeout, httpx.UnsupportedProtocol) as error:
            raise NotConnected(
                f"{self.name} does not take a connection: {error}.",
                remedy="Check its power, the network cable and the address.",
            ) from error
        except httpx.TimeoutException as error:
            raise NoReply(
                f"{self.name} does not answer.", remedy="Check that the device is switched on."
            ) from error
        except httpx.LocalProtocolError as error:
            raise NotConnected(f"{self.name}: the request is not valid HTTP: {error}.") from error
        except httpx.RemoteProtocolError as error:
            if "without sending" in str(error) or "incomplete" in str(error):
                raise LinkLost(f"{self.name} closed the connection: {error}.") from error
            raise Garbled(
                f"{self.name} sent an answer that is not HTTP: {error}.", remedy="Check the port."
            ) from error
        except httpx.DecodingError as error:
            raise Garbled(f"{self.name} sent an answer that cannot be decoded: {error}.") from error
        except httpx.HTTPError as error:
            raise LinkLost(f"{self.name}: the connection is lost: {error}.") from error


def _question(request: httpx.Request) -> bytes:
    return f"{request.method} {request.url.raw_path.decode()}\n".encode() + request.read()
