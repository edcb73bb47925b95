"""A lab with users, and clients of each of them."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.client._lab import API
from labos.core.decide import Command
from labos.core.decide.users import AddUser, GrantRole
from labos.settings import Settings
from labos.spec import find_spec, load_workcell

PASSWORDS = {"ada": "correct horse battery", "bob": "staple of four words"}
"""ada is the lab's admin, bob a submitter; ``agent`` is a service account."""


def execute(lab: LabThread, command: Command, by: str) -> Any:
    """A command, past HTTP."""
    assert lab._loop is not None
    return asyncio.run_coroutine_threadsafe(lab.runtime.kernel.execute(command, by), lab._loop).result(30)


@contextmanager
def lab_with_users(folder: Path, **settings: Any) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    with LabThread(
        Settings.make(folder / "lab", speed=5000.0, simulate=True, **settings), [cell], nodes="none"
    ) as lab:
        if lab.runtime.kernel.state.users.is_open:
            for user, kind in (("ada", "person"), ("bob", "person"), ("agent", "service")):
                execute(lab, AddUser(user, kind), "ada")  # type: ignore[arg-type]
            for user in ("bob", "agent"):
                execute(lab, GrantRole(f"user:{user}", "submitter"), "ada")
            with LabClient(home=folder / "lab") as home:
                for user, password in PASSWORDS.items():
                    home.set_password(user, password)
        yield lab


def token_of(folder: Path, user: str, **options: Any) -> str:
    """A token of a user, made by the owner of the lab's folder."""
    with LabClient(home=folder / "lab") as home:
        return str(home.make_token("test", user=user, **options)["secret"])


def client_of(lab: LabThread, token: str = "", **headers: str) -> httpx.Client:
    shown: Mapping[str, str] = {"authorization": f"Bearer {token}"} if token else {}
    return httpx.Client(base_url=lab.url + API, timeout=30, headers={**shown, **headers})
