"""Which driver serves a module: by its model, or in files of other labs by what model and name suggest."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from labos.core.model import Description

SHORTEST = 2
"""Letters and digits of a word that may name a driver."""


def match_driver(model: str, descriptions: Mapping[str, Description]) -> str | None:
    """The driver that serves a model; the first of several."""
    return next(iter(list_drivers(model, descriptions)), None)


def list_drivers(model: str, descriptions: Mapping[str, Description]) -> list[str]:
    """The drivers that serve a model: exactly, or if none does, without regard to capitals, spaces and
    signs (``UR-5e`` is ``ur5e``)."""
    for same in (str, str.lower, _strip_separators):
        found = [
            driver
            for driver, description in descriptions.items()
            if same(model) in {same(known) for known in (*description.models, driver)}
        ]
        if found:
            return found
    return []


def suggest_driver(text: str, descriptions: Mapping[str, Description]) -> str | None:
    """The one driver that the words of a model or of a module's name speak of: ``Opentrons OT-2`` and
    ``ot2_pcr_alpha`` of ``ot2``, ``Inheco single plate incubator shaker`` of ``inheco``. None if they speak
    of none, or of several."""
    words = _split_words(text)
    found: dict[str, int] = {}
    for driver, description in descriptions.items():
        for known in (driver, *description.models):
            if (length := _measure_longest_common(words, _split_words(known))) >= SHORTEST:
                found[driver] = max(found.get(driver, 0), length)
    if not found:
        return None
    most = max(found.values())
    best = [driver for driver, length in found.items() if length == most]
    others = [driver for driver in found if driver not in best and _is_of(descriptions[driver], words)]
    return best[0] if len(best) == 1 and not others else None


def _is_of(description: Description, words: list[str]) -> bool:
    """Whether the driver itself is named among the words."""
    return _strip_separators(description.driver) in words


def _measure_longest_common(words: list[str], known: list[str]) -> int:
    """Letters of the longest run of whole words of a text that is a run of whole words of a known name."""
    ours, theirs = _list_runs_of_words(words), _list_runs_of_words(known)
    return max((len(run) for run in ours & theirs if not run.isdigit()), default=0)


def _list_runs_of_words(words: list[str]) -> set[str]:
    return {"".join(words[a:b]) for a in range(len(words)) for b in range(a + 1, len(words) + 1)}


def _split_words(text: str) -> list[str]:
    return re.findall(r"[a-z0-9]+", text.lower())


def _strip_separators(text: str) -> str:
    return "".join(_split_words(text))


def list_models(descriptions: Mapping[str, Description]) -> Iterable[str]:
    """Every model that some driver serves."""
    return [model for description in descriptions.values() for model in description.models]
