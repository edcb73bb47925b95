"""Publications in an index of Globus Search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from labos.errors import BadInput
from labos.services.compute import SendingRecord
from labos.services.globus._asking import GlobusAccess, GlobusFailed, wait_for

SERVICE = "Globus Search"


class GlobusIndex(GlobusAccess):
    """An index of Globus Search: its id, who may see the publications (``["public"]``, for example, or URNs
    of users and groups), and how the program authenticates (see `GlobusAccess`)."""

    service = SERVICE

    index: str
    visible_to: Sequence[str]

    def __post_init__(self) -> None:
        if not self.visible_to or isinstance(self.visible_to, str):
            raise BadInput(
                "It is not defined who may see the publication.",
                remedy='Give visible_to, for example visible_to=["public"].',
            )
        super().__post_init__()

    @cached_property
    def client(self) -> Any:
        """The client with the right to write to it."""
        return self.open_client("SearchClient")


def ingest_once(index: GlobusIndex, sent: SendingRecord, subject: str, content: Mapping[str, Any]) -> str:
    """Put an entry into the index and wait until it can be found; returns the task. An entry has the same
    subject each time it is sent, so a second copy replaces the first. Raises GlobusFailed, GlobusRefused,
    GlobusUnreachable."""
    known = sent.find_own("sent")
    if known is None:
        entry = {"subject": subject, "visible_to": list(index.visible_to), "content": dict(content)}
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
