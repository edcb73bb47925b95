"""Erasing what people wrote: reasons, notes and comments, which stand beside the log."""

from __future__ import annotations

from typing import Annotated

import msgspec

from labos.core.decide.erasure import MOST_RECORDS, RefuseErasure
from labos.core.erasure import REASONS, Erasure
from labos.core.structs import make_from
from labos.errors import NotFound
from labos.http.erasing import ErasureDone, erase
from labos.http.limits import Asker, Name, Time, says
from labos.http.method import Method
from labos.http.operation import Call, Operation, list_operations

_CODES = ", ".join(f"`{code}` ({why})" for code, why in REASONS.items())


class OfErasure(msgspec.Struct, frozen=True):
    erasure: Annotated[
        Name, msgspec.Meta(description="the id of an erasure that waits for a second person", examples=["X1"])
    ]


class NewErasure(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Either ``records`` or a ``user``."""

    because: Annotated[Name, says(f"a code: {_CODES}")]
    by: Asker = ""
    records: Annotated[
        list[Time],
        msgspec.Meta(max_length=MOST_RECORDS),
        says("positions of the events whose words are erased"),
    ] = []
    user: Annotated[Name, says("erase the words of all events of this user")] = ""


class Agreement(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    by: Asker = ""


class ErasureView(msgspec.Struct, frozen=True):
    """A request of ``by`` at ``asked_at`` (UTC nanoseconds) that waits for a second person under the id
    ``erasure``."""

    erasure: str
    because: str
    by: str
    records: tuple[int, ...]
    user: str
    asked_at: int


class Erasures(msgspec.Struct, frozen=True):
    erasures: list[ErasureView]


class ErasureReference(msgspec.Struct, frozen=True):
    erasure: str


_DONE = {"erasure": "", "erased": 1, "records": [120], "position": 245, "left": ""}


@Operation(
    route="GET /words/erasures",
    client=Method("erasures", take="erasures"),
    summary="List the erasures that wait for a second person",
    needs="viewer",
)
def list_erasures(call: Call) -> Erasures:
    waiting = call.kernel.state.erasures.open
    return Erasures([make_from(ErasureView, each, erasure=name) for name, each in waiting.items()])


@Operation(
    route="POST /words/erasures",
    client=Method("erase_words"),
    summary="Erase what people wrote into events",
    needs="admin",
    at_kernel=True,
    problems=("not_found", "refused"),
    example={"records": [120], "because": "personal", "by": "ada"},
    example_answer=_DONE,
)
async def erase_words(call: Call, body: NewErasure) -> ErasureDone:
    """The texts and the salts of their digests are deleted. The events stay, and the log still verifies. Each
    text is then shown as `(erased)`. An event records the erasure, the user and the reason. If the policy has
    `erasure: true`, nothing is deleted before a second admin has agreed."""
    return await erase(call, body.because, body.by, body.records, body.user)


@Operation(
    route="POST /words/erasures/{erasure}/approve",
    client=Method("approve_erasure"),
    summary="Agree to an erasure, as the second person",
    needs="admin",
    at_kernel=True,
    problems=("refused",),
    example={"by": "olga"},
    example_answer=_DONE,
)
async def approve_erasure(call: Call, path: OfErasure, body: Agreement) -> ErasureDone:
    """The user who asked for the erasure cannot agree to it. The present words at these events are erased."""
    asked = _find_erasure(call, path.erasure)
    return await erase(call, asked.because, body.by, asked.records, asked.user, path.erasure)


@Operation(
    route="POST /words/erasures/{erasure}/refuse",
    client=Method("refuse_erasure", take="erasure", repeat=True),
    summary="Refuse an erasure that waits for a second person",
    needs="admin",
    problems=("refused",),
    example={"by": "olga"},
    example_answer={"erasure": "X1"},
)
async def refuse_erasure(call: Call, path: OfErasure, body: Agreement) -> ErasureReference:
    """Nothing is erased. The user who asked can withdraw the request in this way."""
    _find_erasure(call, path.erasure)
    await call.kernel.execute(RefuseErasure(path.erasure, body.by), body.by)
    return ErasureReference(path.erasure)


def _find_erasure(call: Call, name: str) -> Erasure:
    """Raises NotFound."""
    found = call.kernel.state.erasures.open.get(name)
    if found is None:
        raise NotFound(f"No erasure {name!r} waits for a second person.", remedy="List them: labos erase")
    return found


OPERATIONS = list_operations(globals(), "log")
