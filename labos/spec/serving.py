"""The driver of a module, found by its model; in files of other labs, also by the words of its model and
name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from labos.core.model import Description

SHORTEST = 2
"""The fewest letters and digits of a word that may name a driver."""


def match_driver(model: str, descriptions: Mapping[str, Description]) -> str | None:
    """The driver for a model; the first one if there are several."""
    return next(iter(list_drivers(model, descriptions)), None)


def list_drivers(model: str, descriptions: Mapping[str, Description]) -> list[str]:
    """The drivers for a model: with exactly this model, or if there is none, without regard to capitals,
    spaces and signs (``UR-5e`` is ``ur5e``)."""
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
    """The only driver to which the words of a model or of a module's name refer: ``ot2`` for ``Opentrons
    OT-2`` and ``ot2_pcr_alpha``, ``inheco`` for ``Inheco single plate incubator shaker``. None if they refer
    to none, or to several."""
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
    """Whether the driver's own name is among the words."""
    return _strip_separators(description.driver) in words


def _measure_longest_common(words: list[str], known: list[str]) -> int:
    """The number of letters in the longest sequence of whole words that a text and a known name have in
    common."""
    ours, theirs = _list_runs_of_words(words), _list_runs_of_words(known)
    return max((len(run) for run in ours & theirs if not run.isdigit()), default=0)


def _list_runs_of_words(words: list[str]) -> set[str]:
    return {"".join(words[a:b]) for a in range(len(words)) for b in range(a + 1, len(words) + 1)}


def _split_words(text: str) -> list[str]:
    return re.findall(r"[a-z0-9]+", text.lower())


def _strip_separators(text: str) -> str:
    return "".join(_split_words(text))


def list_models(descriptions: Mapping[str, Description]) -> Iterable[str]:
    """All models of all drivers."""
    return [model for description in descriptions.values() for model in description.models]
