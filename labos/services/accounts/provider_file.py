"""The file that says which identity provider people may sign in with, and what its groups mean here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from labos.errors import BadInput, Undelivered
from labos.services.notify.contacts import LOOPBACK, Secret
from labos.spec.findings import Report, SpecErrors
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


class ProviderFile(Part):
    """``issuer`` is the provider's own name, a URL. ``lab`` is the address under which browsers reach the
    lab. ``new_users``: whoever the provider knows may look, under an id that the lab makes; else an admin
    says who is who (`labos user link`). ``groups`` and ``roles`` say what the values of ``groups_claim`` mean
    here; at each sign-in exactly those that are named are given and taken."""

    labos: Literal[1] = 1
    issuer: SecureUrl
    client_id: str = Field(min_length=1)
    client_secret: Secret | None = None
    lab: SecureUrl
    scopes: list[str] = ["openid", "profile"]
    groups_claim: str = "groups"
    groups: dict[str, str] = {}
    roles: dict[str, list[GrantedRole]] = {}
    new_users: bool = False
    keep_names: bool = True

    @property
    def secret(self) -> str:
        """The client's secret; empty for a public client. Raises BadInput."""
        try:
            return self.client_secret.value() if self.client_secret is not None else ""
        except Undelivered as error:
            raise BadInput(error.message, remedy=error.remedy) from None


def load_provider(source: Source | str | Path) -> ProviderFile:
    """Read the file. Raises SpecError or SpecErrors with line and column."""
    source = source if isinstance(source, Source) else read(source)
    report = Report(source.file)
    found = validate(ProviderFile, source, report)
    if found is None or report.errors:
        raise SpecErrors(report.sorted())
    return found
