"""Texts of people, devices and programs: how many characters are kept, and in which form."""

from __future__ import annotations

import re

LONGEST_NAME = 200
"""The most characters of a name: of a person, module, station, labware type, lot, request …"""

LONGEST_REASON = 1_000
"""The most characters of a reason (``why``), which is one line."""

LONGEST_NOTE = 4_000
"""The most characters of a note, which may have several lines."""

LONGEST_REPORT = 4_000
"""The most characters that are kept of a report by a device, node or program."""

CUT = " … (cut)"

CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")
"""Characters that no name may contain: control characters, line breaks, unpaired surrogates."""

CONTROL_IN_NOTE = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")
"""Characters that no note may contain; a note may have several lines."""


def make_code(name: str) -> str:
    """The code of a class of errors or reasons: ``ModuleBusy`` is ``module_busy``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def strip_unprintable(text: str) -> str:
    """The text without characters that cannot be recorded or shown."""
    return CONTROL_IN_NOTE.sub("\ufffd", text.replace("\r\n", "\n").replace("\r", "\n"))


def cut(text: str, most: int = LONGEST_REPORT) -> str:
    """The printable text, with at most ``most`` characters."""
    text = strip_unprintable(text)
    return text if len(text) <= most else text[: most - len(CUT)] + CUT
