"""Files that Globus copies from one collection to another: each is submitted once."""

from __future__ import annotations

from functools import cached_property
from typing import Any
from urllib.parse import unquote, urlsplit

import msgspec

from labos.errors import BadInput
from labos.services.compute import SendingRecord
from labos.services.globus._asking import (
    GlobusAccess,
    GlobusFailed,
    GlobusRefused,
    GlobusTimes,
    ask,
    report_missing_sdk,
    wait_for,
)

SERVICE = "Globus Transfer"
SCHEME = "globus"


class GlobusPlace(msgspec.Struct, frozen=True):
    """A file in a collection."""

    collection: str
    path: str

    @classmethod
    def parse(cls, url: str) -> GlobusPlace:
        """The file that ``globus://<collection>/<path>`` names. Raises BadInput."""
        parts = urlsplit(url)
        if parts.scheme != SCHEME or not parts.netloc or len(parts.path) < 2:
            raise BadInput(
                f"{url!r} is not a file of a Globus collection.",
                remedy="Write globus://, the id of the collection, and the path: globus://1234-…/plate.csv",
            )
        return cls(parts.netloc, unquote(parts.path))


class GlobusCarrier(GlobusAccess):
    """Globus Transfer, and how the program authenticates (see `GlobusAccess`)."""

    service = SERVICE

    @cached_property
    def client(self) -> Any:
        return self.open_client("TransferClient")


class Moved(msgspec.Struct, frozen=True):
    """A file that has arrived: ``sha256`` is empty if it was not given and Globus does not report it."""

    task: str
    bytes: int
    sha256: str


def transfer_once(
    carrier: GlobusCarrier,
    sent: SendingRecord,
    source: GlobusPlace,
    target: GlobusPlace,
    *,
    sha256: str = "",
    label: str = "",
) -> Moved:
    """Let Globus copy a file and compare the checksums, and wait for the end. The id of the submission is
    recorded first: Globus carries it out once, however often it is submitted. Raises GlobusFailed,
    GlobusRefused, GlobusUnreachable."""
    try:
        from globus_sdk import MISSING, TransferData
    except ImportError:
        raise report_missing_sdk() from None
    client, patience = carrier.client, carrier.patience
    known = sent.find_own("sent")
    if known is None:
        submission = sent.find_own("sending")
        if submission is None:
            id_ = wait_for(SERVICE, patience, lambda: str(client.get_submission_id()["value"]))
            submission = sent.keep("sending", {"submission": id_})
        data = TransferData(
            source.collection,
            target.collection,
            submission_id=submission["submission"],
            label=label[:128] or MISSING,
            verify_checksum=True,
        )
        data.add_item(
            source.path,
            target.path,
            external_checksum=sha256 or MISSING,
            checksum_algorithm="SHA256" if sha256 else MISSING,
        )
        task = wait_for(SERVICE, patience, lambda: str(client.submit_transfer(data)["task_id"]))
        known = sent.keep("sent", {"submission": submission["submission"], "task": task})
    return _wait(client, str(known["task"]), sha256, patience)


def _wait(client: Any, task: str, sha256: str, patience: GlobusTimes) -> Moved:
    def look() -> dict[str, Any] | None:
        found: dict[str, Any] = client.get_task(task).data
        return None if found["status"] == "ACTIVE" else found

    ended = wait_for(SERVICE, patience, look)
    why = ended.get("fatal_error") or {}
    if ended["status"] == "FAILED":
        reason = f"{why.get('code', '')}: {why.get('description', '')}".strip(": ") or "without a reason"
        raise GlobusFailed(f"The task {task} of {SERVICE} failed: {reason}.")
    if ended["status"] != "SUCCEEDED":
        raise GlobusRefused(
            f"The task {task} of {SERVICE} has stopped ({ended['status']}).",
            remedy="Usually a sign-in has expired: sign in to the collection; then start the program again.",
        )
    if not sha256:
        (*_, file) = ask(SERVICE, lambda: list(client.task_successful_transfers(task))) or [{}]
        if str(file.get("checksum_algorithm", "")).upper() == "SHA256":
            sha256 = str(file.get("checksum", ""))
    return Moved(task, int(ended["bytes_transferred"]), sha256)
