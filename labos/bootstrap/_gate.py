"""Access to a lab: its accounts, the key in its folder, and its addresses."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import structlog

from labos.clock import Clock
from labos.core.decide.users import AddUser
from labos.core.users import UserDisabled
from labos.errors import BadInput, StoreError
from labos.http.door import WAY_BACK
from labos.http.feed import Feed
from labos.http.finding import Finder
from labos.http.identity import Gate
from labos.http.operation import Api
from labos.http.parts import LabKernel, Parts
from labos.http.server import Listening, is_own_address
from labos.http.service import LabService
from labos.http.viewers import Viewers
from labos.private import create_file
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import OnEvents
from labos.runtime.marks import Marks
from labos.services.accounts import HOME, Accounts, make_secret
from labos.services.accounts.accounts import FRESH_S
from labos.services.accounts.provider_file import load_provider
from labos.settings import OIDC, Settings
from labos.store import SqlEventStore, open_accounts
from labos.telemetry.process_metrics import Signing

if TYPE_CHECKING:
    from labos.services.accounts.oidc import Provider

_log = structlog.get_logger(__name__)


def describe_listening(settings: Settings, port: int) -> Listening:
    """The addresses at which HTTP is served."""
    return Listening(
        settings.host,
        port,
        settings.names,
        settings.tls_certificate,
        settings.tls_key,
        settings.behind_proxy,
    )


def expect_tls(settings: Settings) -> None:
    """Raises BadInput for an address that other computers can reach, if passwords and tokens would cross the
    network unencrypted, or if the user has not permitted that the bus can be reached."""
    if is_own_address(settings.host):
        return
    if not settings.tls_certificate and not settings.behind_proxy:
        raise BadInput(
            f"Other computers reach {settings.host}, and passwords would be sent over the network "
            "unencrypted.",
            remedy="Leave --host out, or give --tls-cert and --tls-key, or add --behind-proxy if another "
            "program speaks TLS for the lab.",
        )
    if not settings.bus and not settings.is_secure and not settings.open_to_network:
        raise BadInput(
            f"The bus would listen on {settings.host} without certificates: every program that can "
            "connect can pose as a node.",
            remedy="Make it a secure one (--secure), leave --host out, or add --open-to-network if you "
            "trust all computers in that network.",
        )


async def add_first_user(settings: Settings, kernel: Kernel) -> None:
    """Add the first user to a lab without users, if the settings name one. Raises Refused for an id that is
    not allowed."""
    if settings.first_user and kernel.state.users.is_open:
        await kernel.execute(AddUser(settings.first_user), settings.first_user)


async def give_first_password(settings: Settings, accounts: Accounts) -> None:
    """Set the password of the first user, unless there is one. Raises BadInput."""
    user, file = settings.first_user, settings.first_password
    if not file or not user or await accounts.has_password(user):
        return
    await accounts.set_password(user, _password_in(file, user))


def _password_in(file: str, user: str) -> str:
    try:
        return Path(file).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(
            f"The password of {user} cannot be read from {file}: {error}.",
            remedy="Give a file that contains only the password.",
        ) from None


def expect_users(settings: Settings, kernel: LabKernel) -> None:
    """Raises BadInput for a lab that other computers can reach and in which everybody may do everything."""
    is_own = is_own_address(settings.host)
    if kernel.state.users.is_open and (not is_own or settings.behind_proxy):
        where = "the lab through a proxy" if is_own else settings.host
        raise BadInput(
            f"Other computers reach {where}, and this lab has no users: every program that can "
            "connect could control it.",
            remedy=f"First add a user, on this computer: labos user add NAME --home {settings.home} (or give "
            "--first-user NAME).",
        )


@contextmanager
def open_gate(
    settings: Settings, accounts_url: str, kernel: LabKernel, signing: Signing, key: str = ""
) -> Iterator[Gate]:
    """The gate of a running lab, or of an API process, with the accounts in a database. ``key`` is the key in
    the lab's folder, which only the kernel's process accepts."""
    store = open_accounts(accounts_url)
    try:
        accounts = Accounts(store, kernel.clock, lambda user: kernel.state.users.get(user) is not None)
        gate = Gate(
            accounts,
            lambda: kernel.state.users,
            key,
            secure=describe_listening(settings, 0).is_secure,
            provider=_read_provider(settings, kernel.clock),
        )
        kernel.listeners.append(OnEvents((UserDisabled,), lambda event: accounts.end_of_user(event.user)))
        signing.watch(accounts.on_try, gate.on_refusal)
        yield gate
    finally:
        store.close()


def lay_home_key(settings: Settings, stack: AsyncExitStack) -> str:
    """A new key, which is in the lab's folder until the ``stack`` is closed."""
    key = make_secret(HOME)
    with create_file(settings.home_key) as file:
        file.write(f"{key}\n".encode())
    stack.callback(_remove, settings)
    return key


def make_service(parts: Parts, settings: Settings) -> LabService:
    """The operations of a lab's HTTP interface, on the parts of this process."""
    feed = Feed()
    parts.kernel.listeners.append(feed)
    # Clients that follow the log have a separate process, where a connection can be passed to one.
    viewers = Viewers(settings.database) if sys.platform != "win32" else None
    service = LabService(parts, feed, viewers)
    service.finder = Finder(settings.database, settings.blobs, settings.home)
    return service


def follow_marks(store: SqlEventStore, kernel: LabKernel, stack: AsyncExitStack) -> Marks:
    """The marks of requests in the log, until the ``stack`` is closed."""
    marks = Marks(store)
    kernel.listeners.append(marks)
    marks.begin()
    stack.push_async_callback(marks.close)
    return marks


async def end_streams(api: Api) -> None:
    """End the streams of users whose token or session was revoked by another process; runs without end."""
    while True:
        await asyncio.sleep(FRESH_S)
        try:
            await api.gate.accounts.check_again(api.ends.followed)
        except StoreError as error:
            _log.warning("accounts_not_read", why=str(error))


def _read_provider(settings: Settings, clock: Clock) -> Provider | None:
    """The identity provider that the file in the lab's folder names. Raises SpecErrors, BadInput."""
    if not os.environ.get(OIDC) and not settings.providers.is_file():
        return None
    from labos.services.accounts.oidc import Provider  # few labs have one

    return Provider(load_provider(settings.providers), clock, WAY_BACK)


def _remove(settings: Settings) -> None:
    with suppress(OSError):
        settings.home_key.unlink()
