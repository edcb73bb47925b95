"""The operations of labos/http/routes/words.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedWords(Calls):
    """One method for each operation."""

    def erasures(self) -> list[dict[str, Any]]:
        """What is to be erased, and waits for a second person."""
        return self._get("/words/erasures")["erasures"]

    def erase_words(
        self, because: str, by: str, *, records: Sequence[int] = (), user: str = ""
    ) -> dict[str, Any]:
        """Erase what people wrote into events. The texts are deleted, with the salts of their digests; the
        events stay, and the log verifies as before. Each is shown as ``(erased)`` from then on. That, who did
        it and why is an event. Where the policy says ``erasure: true``, nothing is done before a second admin
        has agreed. ``because``: a code: ``request`` (the person who wrote it, or whom it is about, asked for
        it), ``personal`` (it tells of a person what does not belong there), ``secret`` (it holds a password,
        or what is confidential), ``mistake`` (it was written in the wrong place), ``retention`` (it was kept
        for as long as the rules say), ``order`` (a court or an authority ordered it). ``records``: positions
        of the events whose words go. ``user``: the words of all events of this user go. Returns ``erasure``,
        ``erased``, ``records``, ``position``, ``left``. Raises NotFound, Refused."""
        return self._post("/words/erasures", {"because": because, "by": by, "records": records, "user": user})

    def approve_erasure(self, erasure: str, by: str) -> dict[str, Any]:
        """Agree, as the second person, that words are erased. The user who asked for it cannot agree. What
        stands there now is erased. Returns ``erasure``, ``erased``, ``records``, ``position``, ``left``.
        Raises Refused."""
        return self._post(f"/words/erasures/{in_path(erasure)}/approve", {"by": by})

    def refuse_erasure(self, erasure: str, by: str) -> str:
        """Do not erase what waits for a second person. Nothing is erased. The user who asked may take it back
        this way. Raises Refused."""
        return self._post(f"/words/erasures/{in_path(erasure)}/refuse", {"by": by}, repeat=True)["erasure"]
