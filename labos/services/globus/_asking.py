"""Requests to Globus: the meaning of its errors, and how a request is carried out once although answers are
lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar, TypeVar

import msgspec

from labos.errors import BadInput
from labos.services.compute import PlaceUnavailable

T = TypeVar("T")

TOO_MANY = 429
NOT_LET_IN = (401, 403)


class GlobusTimes(msgspec.Struct, frozen=True):
    """Waiting times for Globus. A status is requested every ``first_s`` seconds at the beginning, then less
    often, at least every ``longest_s``. After ``silence_s`` without an answer, Globus counts as unreachable.
    After a lost answer, LabOS waits ``settle_s`` and then asks which requests have arrived."""

    first_s: float = 0.5
    longest_s: float = 10.0
    silence_s: float = 600.0
    settle_s: float = 2.0


class GlobusAccess(msgspec.Struct, kw_only=True, dict=True, eq=False):
    """How a program authenticates: with an ``app`` (`globus_sdk.UserApp`, `ClientApp`) or an ``authorizer``
    of `globus_sdk`. ``base_url`` replaces the address of the service. Raises BadInput if there is neither."""

    service: ClassVar[str]

    app: Any = None
    authorizer: Any = None
    base_url: str | None = None
    patience: GlobusTimes = GlobusTimes()

    def __post_init__(self) -> None:
        if (self.app is None) == (self.authorizer is None):
            raise BadInput(
                f"The program has no credentials for {self.service}.",
                remedy="Give either `app=globus_sdk.UserApp(…)` or an `authorizer`.",
            )

    def __repr__(self) -> str:
        return f"<{type(self).__name__}>"  # without credentials

    def open_client(self, kind: str, *args: Any) -> Any:
        """A client of a class of `globus_sdk`. Raises BadInput if the SDK is not installed."""
        try:
            import globus_sdk
        except ImportError:
            raise report_missing_sdk() from None
        made = getattr(globus_sdk, kind)(*args, app=self.app, authorizer=self.authorizer)
        if self.base_url is not None:  # one of the classes has no parameter `base_url`
            made.base_url = self.base_url
        # The SDK's one repetition renews an expired token; all other repetitions are ours.
        made.retry_config.max_retries = 1
        return made


class GlobusError(PlaceUnavailable):
    """Globus has not carried out a request."""


class GlobusRefused(GlobusError):
    """Globus refuses the program's access, or does not accept the request."""


class GlobusUnreachable(GlobusError):
    """Globus does not answer."""


class GlobusFailed(GlobusError):
    """A task that Globus had begun has failed."""


def report_missing_sdk() -> BadInput:
    return BadInput("Globus' SDK is not installed.", remedy='pip install "labos-sdl[globus]"')


def ask(what: str, call: Callable[[], T]) -> T:
    """The answer to a question. Raises GlobusRefused, GlobusUnreachable."""
    from globus_sdk import GlobusAPIError
    from globus_sdk.exc import NetworkError

    try:
        return call()
    except GlobusAPIError as error:
        text = f"{error.http_status} {error.code or ''}: {error.message or error.text[:200]}"
        if error.http_status in NOT_LET_IN:
            raise GlobusRefused(
                f"{what} refuses the program's credentials ({text}).",
                remedy="Sign in again, with the scopes that are needed; then start the program again: it "
                "continues.",
            ) from error
        if error.http_status == TOO_MANY or error.http_status >= 500:
            raise GlobusUnreachable(f"{what} does not answer ({text}).", remedy=_LATER) from error
        raise GlobusRefused(f"{what} refuses the request ({text}).") from error
    except NetworkError as error:
        raise GlobusUnreachable(f"{what} does not answer ({error}).", remedy=_LATER) from error


_LATER = "Start the program again later: it continues and sends nothing twice."


def wait_for(what: str, patience: GlobusTimes, look: Callable[[], T | None]) -> T:
    """The first result of ``look``, which is called until there is one. Raises GlobusRefused, and
    GlobusUnreachable after a long time without an answer."""
    pause, heard = patience.first_s, time.monotonic()
    while True:
        try:
            found = ask(what, look)
        except GlobusUnreachable:
            if time.monotonic() - heard > patience.silence_s:
                raise
        else:
            heard = time.monotonic()
            if found is not None:
                return found
        time.sleep(pause)
        pause = min(pause * 1.5, patience.longest_s)


def send_once(
    what: str, client: Any, patience: GlobusTimes, send: Callable[[], T], find: Callable[[], T | None]
) -> T:
    """Send a request that Globus would carry out twice if it arrived twice. The SDK's own repetitions are
    switched off. If no answer comes, ``find`` returns what has arrived; only if nothing has, the request is
    sent again. Raises GlobusRefused, GlobusUnreachable."""
    from globus_sdk import GlobusAPIError

    pause, begun = patience.first_s, time.monotonic()
    while True:
        try:
            with _stop_repetitions(client):
                return ask(what, send)
        except GlobusUnreachable as error:
            cause = error.__cause__
            is_refusal = isinstance(cause, GlobusAPIError) and cause.http_status == TOO_MANY
            if time.monotonic() - begun > patience.silence_s:
                raise
            if not is_refusal:
                time.sleep(patience.settle_s)
                found = wait_for(what, patience, lambda: (find(),))[0]
                if found is not None:
                    return found
            time.sleep(max(pause, _find_pause(cause)))
            pause = min(pause * 2, patience.longest_s)


@contextmanager
def _stop_repetitions(client: Any) -> Iterator[None]:
    # After an error, the SDK's own `tune` does not restore the setting.
    config = client.retry_config
    before, config.max_retries = config.max_retries, 0
    try:
        yield
    finally:
        config.max_retries = before


def _find_pause(cause: BaseException | None) -> float:
    """The seconds to wait that an answer with status 429 or 503 demands."""
    headers = getattr(cause, "headers", None) or {}
    text = str(headers.get("Retry-After", ""))
    return float(text) if text.isdecimal() else 0.0
