"""Publications in an index of Globus Search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from labos.errors import BadInput
from labos.services.compute import SendingRecord
from labos.services.globus._asking import GlobusAccess, GlobusFailed, GlobusTimes, wait_for

SERVICE = "Globus Search"


class GlobusIndex:
    """An index of Globus Search: its id, who may see the publications (``["public"]``, for example, or URNs
    of users and groups), and how the program authenticates (see `GlobusAccess`)."""

    def __init__(
        self,
        index: str,
        *,
        visible_to: Sequence[str],
        app: Any = None,
        authorizer: Any = None,
        base_url: str | None = None,
        patience: GlobusTimes | None = None,
    ) -> None:
        if not visible_to or isinstance(visible_to, str):
            raise BadInput(
                "It is not defined who may see the publication.",
                remedy='Give visible_to, for example visible_to=["public"].',
            )
        self._access = GlobusAccess(SERVICE, app=app, authorizer=authorizer, base_url=base_url)
        self.index, self.visible_to = index, list(visible_to)
        self.patience = patience or GlobusTimes()

    @cached_property
    def client(self) -> Any:
        """The client with the right to write to it."""
        return self._access.open("SearchClient")


def ingest_once(index: GlobusIndex, sent: SendingRecord, subject: str, content: Mapping[str, Any]) -> str:
    """Put an entry into the index and wait until it can be found; returns the task. An entry has the same
    subject each time it is sent, so a second copy replaces the first. Raises GlobusFailed, GlobusRefused,
    GlobusUnreachable."""
    known = sent.find_own("sent")
    if known is None:
        entry = {"subject": subject, "visible_to": index.visible_to, "content": dict(content)}
        document = {"ingest_type": "GMetaEntry", "ingest_data": entry}
        sent.keep("sending", {"index": index.index, "subject": subject})
        task = wait_for(
            SERVICE, index.patience, lambda: str(index.client.ingest(index.index, document)["task_id"])
        )
        known = sent.keep("sent", {"index": index.index, "subject": subject, "task": task})

    def look() -> dict[str, Any] | None:
        found: dict[str, Any] = index.client.get_task(known["task"]).data
        return found if found["state"] in ("SUCCESS", "FAILED") else None

    ended = wait_for(SERVICE, index.patience, look)
    if ended["state"] == "FAILED":
        why = ended.get("message") or ended.get("state_description") or "without a reason"
        raise GlobusFailed(f"The task {known['task']} of {SERVICE} failed: {why}.")
    return str(known["task"])
