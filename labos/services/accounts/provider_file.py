"""The file that names the identity provider for signing in, and maps the provider's groups to roles in the
lab."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from labos.errors import BadInput, Undelivered
from labos.services.notify.contacts import LOOPBACK, Secret
from labos.spec.findings import FindingList, SpecErrors
from labos.spec.parts import Part
from labos.spec.source import Source, read
from labos.spec.validation import validate


def _secure(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme != "https" and not (parts.scheme == "http" and parts.hostname in LOOPBACK):
        raise ValueError("it begins with https://")
    return url


SecureUrl = Annotated[str, AfterValidator(_secure)]


class GrantedRole(Part):
    """A role in a workcell; in the whole lab if none is named."""

    role: Literal["viewer", "submitter", "operator", "admin"]
    workcell: str = "*"


class CommandLine(Part):
    """The provider's registration of `labos login`: a client with the redirect address
    ``http://127.0.0.1/login/…``, at any port, that may also use the device grant. ``days`` is the longest
    validity of its tokens."""

    client_id: str = Field(min_length=1)
    client_secret: Secret | None = None
    days: float = Field(default=7.0, gt=0, le=366)


class ProviderFile(Part):
    """``issuer`` is the provider's own name, a URL. ``lab`` is the address under which browsers reach the
    lab. With ``command_line``, users may also sign in from a command line. With ``new_users``, everybody whom
    the provider knows may view the lab, under an id that the lab makes; without it, an admin links each user
    first (`labos user link`). ``groups`` and ``roles`` map the values of ``groups_claim`` to groups and roles
    of this lab. Each sign-in grants and revokes exactly the groups and roles that are named here."""

    labos: Literal[1] = 1
    issuer: SecureUrl
    client_id: str = Field(min_length=1)
    client_secret: Secret | None = None
    lab: SecureUrl
    command_line: CommandLine | None = None
    scopes: list[str] = ["openid", "profile"]
    groups_claim: str = "groups"
    groups: dict[str, str] = {}
    roles: dict[str, list[GrantedRole]] = {}
    new_users: bool = False
    keep_names: bool = True

    @property
    def secret(self) -> str:
        """The client's secret; empty for a public client. Raises BadInput."""
        return _read_value(self.client_secret)

    @property
    def secret_of_command_line(self) -> str:
        """As ``secret``, for the client of `labos login`."""
        return _read_value(self.command_line.client_secret if self.command_line is not None else None)


def _read_value(secret: Secret | None) -> str:
    try:
        return secret.value() if secret is not None else ""
    except Undelivered as error:
        raise BadInput(error.message, remedy=error.remedy) from None


def load_provider(source: Source | str | Path) -> ProviderFile:
    """Read the file. Raises SpecError or SpecErrors with line and column."""
    source = source if isinstance(source, Source) else read(source)
    report = FindingList(source.file)
    found = validate(ProviderFile, source, report)
    if found is None or report.errors:
        raise SpecErrors(report.sort_findings())
    return found
