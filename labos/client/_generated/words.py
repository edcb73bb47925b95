"""The operations of labos/http/routes/words.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.client._calls import Calls


class GeneratedWords(Calls):
    """One method for each operation."""

    def erasures(self) -> list[dict[str, Any]]:
        """List the erasures that wait for a second person."""
        return self._get("/words/erasures")["erasures"]

    def erase_words(
        self, because: str, by: str, *, records: Sequence[int] = (), user: str = ""
    ) -> dict[str, Any]:
        """Erase what people wrote into events. The texts and the salts of their digests are deleted. The
        events stay, and the log still verifies. Each text is then shown as ``(erased)``. An event records the
        erasure, the user and the reason. If the policy has ``erasure: true``, nothing is deleted before a
        second admin has agreed. ``because``: a code: ``request`` (the author, or the person whom the text
        concerns, asked for it), ``personal`` (it holds personal data that do not belong there), ``secret``
        (it holds a password or something confidential), ``mistake`` (it was written in the wrong place),
        ``retention`` (its retention period has ended), ``order`` (a court or an authority ordered it).
        ``records``: positions of the events whose words are erased. ``user``: erase the words of all events
        of this user. Returns ``erasure``, ``erased``, ``records``, ``position``, ``left``. Raises NotFound,
        Refused."""
        return self._post("/words/erasures", locals())

    def approve_erasure(self, erasure: str, by: str) -> dict[str, Any]:
        """Agree to an erasure, as the second person. The user who asked for the erasure cannot agree to it.
        The present words at these events are erased. Returns ``erasure``, ``erased``, ``records``,
        ``position``, ``left``. Raises Refused."""
        return self._post("/words/erasures/{erasure}/approve", locals())

    def refuse_erasure(self, erasure: str, by: str) -> str:
        """Refuse an erasure that waits for a second person. Nothing is erased. The user who asked can
        withdraw the request in this way. Raises Refused."""
        return self._post("/words/erasures/{erasure}/refuse", locals(), repeat=True)["erasure"]
