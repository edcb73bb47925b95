"""How Globus is asked: what its errors mean, and how something is sent once although answers are lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import msgspec

from labos.errors import BadInput
from labos.services.compute import PlaceUnavailable

T = TypeVar("T")

TOO_MANY = 429
NOT_LET_IN = (401, 403)


class GlobusTimes(msgspec.Struct, frozen=True):
    """How long Globus is waited for. It is asked every ``first_s`` seconds, then more seldom, every
    ``longest_s`` at the most. When it has not answered for ``silence_s``, it is given up. When an answer was
    lost, it is asked ``settle_s`` later what has arrived."""

    first_s: float = 0.5
    longest_s: float = 10.0
    silence_s: float = 600.0
    settle_s: float = 2.0


class GlobusAccess:
    """How a program is let in: an ``app`` (`globus_sdk.UserApp`, `ClientApp`) or an ``authorizer`` of
    `globus_sdk`. ``base_url`` is another address of the service. Raises BadInput if there is none."""

    def __init__(
        self, what: str, *, app: Any = None, authorizer: Any = None, base_url: str | None = None
    ) -> None:
        if (app is None) == (authorizer is None):
            raise BadInput(
                f"It is not said how the program is let in at {what}.",
                remedy="Give either `app=globus_sdk.UserApp(…)` or an `authorizer`.",
            )
        self._access = {"app": app, "authorizer": authorizer}
        self._base_url = base_url

    def open(self, kind: str, *args: Any) -> Any:
        """A client of a class of `globus_sdk`. Raises BadInput if the SDK is not installed."""
        try:
            import globus_sdk
        except ImportError:
            raise report_missing_sdk() from None
        made = getattr(globus_sdk, kind)(*args, **self._access)
        if self._base_url is not None:  # one of the classes takes no `base_url`
            made.base_url = self._base_url
        # A token that has run out is renewed by this one repetition; we are patient in our own way.
        made.retry_config.max_retries = 1
        return made


class GlobusError(PlaceUnavailable):
    """Globus has not done what it was asked for."""


class GlobusRefused(GlobusError):
    """Globus does not let the program in, or takes no such request."""


class GlobusUnreachable(GlobusError):
    """Globus does not answer."""


class GlobusFailed(GlobusError):
    """What Globus has begun came to a bad end."""


def report_missing_sdk() -> BadInput:
    return BadInput("Globus' SDK is not installed.", remedy='pip install "labos-sdl[globus]"')


def ask(what: str, call: Callable[[], T]) -> T:
    """The answer to a question. Raises GlobusRefused, GlobusUnreachable."""
    from globus_sdk import GlobusAPIError
    from globus_sdk.exc import NetworkError

    try:
        return call()
    except GlobusAPIError as error:
        told = f"{error.http_status} {error.code or ''}: {error.message or error.text[:200]}"
        if error.http_status in NOT_LET_IN:
            raise GlobusRefused(
                f"{what} does not let the program in ({told}).",
                remedy="Sign in again, with the scopes that are needed; then start the program again: "
                "it goes on where it was.",
            ) from error
        if error.http_status == TOO_MANY or error.http_status >= 500:
            raise GlobusUnreachable(f"{what} does not answer ({told}).", remedy=_LATER) from error
        raise GlobusRefused(f"{what} takes no such request ({told}).") from error
    except NetworkError as error:
        raise GlobusUnreachable(f"{what} does not answer ({error}).", remedy=_LATER) from error


_LATER = "Start the program again later: it goes on where it was, and sends nothing twice."


def wait_for(what: str, patience: GlobusTimes, look: Callable[[], T | None]) -> T:
    """What ``look`` finds, sooner or later. Raises GlobusRefused, and GlobusUnreachable after a long
    silence."""
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
    """Send something that Globus would do twice if it came twice. The SDK's own repetitions are off. When no
    answer comes, ``find`` says what has arrived; only if nothing has, it is sent again. Raises GlobusRefused,
    GlobusUnreachable."""
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
    # The SDK's own `tune` does not take the setting back after an error.
    config = client.retry_config
    before, config.max_retries = config.max_retries, 0
    try:
        yield
    finally:
        config.max_retries = before


def _find_pause(cause: BaseException | None) -> float:
    """Seconds that an answer with status 429 or 503 asks for."""
    headers = getattr(cause, "headers", None) or {}
    told = str(headers.get("Retry-After", ""))
    return float(told) if told.isdecimal() else 0.0
