"""Limits of requests: the length of texts, the size of numbers, the depth of tables.

The bodies of all routes consist of these types, and every request is checked against them before a handler is
called. docs/reference/http.md describes them for users.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Any, get_type_hints

import msgspec

from labos.errors import BadInput

LONGEST_PERSON = 100
LONGEST_NAME = 200
LONGEST_FILE_NAME = 1_000
LONGEST_LINE = 500
LONGEST_WORDS = 4_000
LONGEST_TEXT = 1024 * 1024
"""Characters of a workflow or workcell file."""
LONGEST_SHEET = 4 * 1024 * 1024
"""Characters of a sample sheet."""
LARGEST_BODY = 96 * 1024 * 1024
"""The largest number of bytes in a request with files."""
SMALL_BODY = 512 * 1024
"""Bytes of any other request."""
LARGEST_CONTENT = 64 * 1024 * 1024
"""The largest number of bytes of a separately stored file."""
LARGEST_BODIES = 192 * 1024 * 1024
"""The largest number of bytes of all requests that are being read."""
LARGEST_TABLE = 48 * 1024
"""The largest number of bytes of a payload, of facts or of a result, as JSON: an event of the log holds 64
KB."""
MOST_FILES = 200
"""The largest number of files that are sent with a workflow or a workcell."""
MOST_ENTRIES = 2_000
"""Entries of a list or table."""
MOST_VARIABLES = 20
"""The largest number of variables of a piece of labware in one request."""
MOST_TAGS = 100
"""Tags of a campaign."""
MOST_VALUES = 20_000
"""Values in a payload, in facts or in a result."""
DEEPEST = 32
"""The largest depth of nested tables and lists."""
WHOLE_NUMBERS = (-(2**63), 2**63 - 1)
HIGHEST_PRIORITY = 100_000
MOST_FILTERS = 50
"""Parameters of one query."""

ONE_LINE = r"\A[^\x00-\x1f\x7f-\x9f\u2028\u2029]*\Z"
SEVERAL_LINES = r"\A[^\x00-\x08\x0b\x0c\x0e-\x1f\x7f]*\Z"
FORMS = {
    ONE_LINE: "holds a line break or a control character",
    SEVERAL_LINES: "holds a control character",
}
"""The fault of a text that does not match a pattern."""


def says(meaning: str, *examples: str) -> msgspec.Meta:
    """The description of a field, for the description of the API and its reference page."""
    return msgspec.Meta(description=meaning, examples=list(examples) or None)


Person = Annotated[str, msgspec.Meta(max_length=LONGEST_PERSON, pattern=ONE_LINE)]
"""The name of a person. ``check_person`` knows which names cannot be a person's."""
WHO_ASKS = says("the user who asks; ignored in a lab that has users, where it is the user who has signed in")
Asker = Annotated[Person, WHO_ASKS]
"""The requesting user: a field for labs without users."""
Name = Annotated[str, msgspec.Meta(max_length=LONGEST_NAME, pattern=ONE_LINE)]
"""The name or id of something."""
Line = Annotated[str, msgspec.Meta(max_length=LONGEST_LINE, pattern=ONE_LINE)]
"""A text for the log, on one line."""
Words = Annotated[str, msgspec.Meta(max_length=LONGEST_WORDS, pattern=SEVERAL_LINES)]
"""A note; it may have several lines."""
FileName = Annotated[str, msgspec.Meta(max_length=LONGEST_FILE_NAME, pattern=ONE_LINE)]
"""The name of a file in error messages: its path, where it was read."""
FileText = Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)]
SheetText = Annotated[str, msgspec.Meta(max_length=LONGEST_SHEET)]
Files = Annotated[dict[Name, bytes], msgspec.Meta(max_length=MOST_FILES)]
FileContent = Annotated[bytes, msgspec.Meta(max_length=LARGEST_CONTENT)]
Secret = Annotated[str, msgspec.Meta(max_length=1000)]
"""A password; it never appears in a log or an answer."""
Priority = Annotated[int, msgspec.Meta(ge=-HIGHEST_PRIORITY, le=HIGHEST_PRIORITY)]
Count = Annotated[int, msgspec.Meta(ge=1, le=10_000)]
Time = Annotated[int, msgspec.Meta(ge=0, le=WHOLE_NUMBERS[1])]
"""UTC nanoseconds; 0 for none."""
Amount = Annotated[float, msgspec.Meta(ge=0, le=1e12)]
Pose = Annotated[list[Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]], msgspec.Meta(max_length=100)]
Names = Annotated[list[Name], msgspec.Meta(max_length=MOST_ENTRIES)]
Variables = Annotated[dict[Name, bool], msgspec.Meta(max_length=MOST_VARIABLES)]
Named = Annotated[dict[Name, Names], msgspec.Meta(max_length=MOST_ENTRIES)]

OWN_NAME = "labos"
SAY_WHO = "Give the name of the requesting person or program."


def check_person(name: str, field: str) -> str:
    """The name of a requesting person. Raises BadInput if it is empty, and for the names of LabOS and its
    modules: entries in the log about a person must not look like LabOS's own."""
    if not name.strip():
        raise BadInput(f"The field {field!r} is empty.", remedy="Name the user.")
    if name.strip().casefold() == OWN_NAME:
        raise BadInput(
            f"The field {field!r} is {name!r}, which is reserved for LabOS itself.", remedy=SAY_WHO
        )
    if "/" in name:
        raise BadInput(
            f"The field {field!r} is {name!r}; only names of modules and stations have a slash.",
            remedy=SAY_WHO,
        )
    return name


def name_in_emergency(text: str) -> str:
    """The name of the person who requests an emergency stop. No name leads to a refusal."""
    name = "".join(char if char.isprintable() and char != "/" else " " for char in text[:LONGEST_PERSON])
    return "somebody" if name.strip().casefold() in ("", OWN_NAME) else name


def check_text(text: str, what: str, longest: int = LONGEST_NAME) -> str:
    """A text of one line from a path, a query or a header. Raises BadInput."""
    wrong = find_misfit(text, longest)
    if wrong:
        raise BadInput(f"{what} {wrong}.", remedy="Shorten or correct it.")
    return text


def find_misfit(text: str, longest: int) -> str:
    """Why a text is not one line with at most so many characters; empty if it is."""
    if len(text) > longest:
        return f"has {len(text)} characters; {longest} are allowed"
    if text.isprintable() or re.match(ONE_LINE, text):
        return ""
    return FORMS[ONE_LINE]


@cache
def asker_of(kind: type[msgspec.Struct]) -> str:
    """The field of a request with the requesting user; empty if it has none."""
    hints = get_type_hints(kind, include_extras=True)
    return next((name for name, hint in hints.items() if WHO_ASKS in getattr(hint, "__metadata__", ())), "")


def check_fields(request: msgspec.Struct) -> None:
    """Checks of a request that its types do not make: the requesting user, and the depth and size of its
    tables. Raises BadInput."""
    asker = asker_of(type(request))
    for field in request.__struct_fields__:
        value = getattr(request, field)
        if field == asker and field != "said_by":
            check_person(value, field)
        elif field in ("payload", "facts", "result"):
            _check_table(value, field)
        elif field == "payloads":
            for number, payload in enumerate(value):
                _check_table(payload, f"{field}[{number}]")


def _check_table(value: Any, field: str) -> None:
    """Raises BadInput for a value that is too deep, too large, or cannot be stored."""
    count, level = 0, [value]
    for _ in range(DEEPEST + 1):
        inner: list[Any] = []
        for item in level:
            count += 1
            if isinstance(item, dict):
                _check_keys(item, field)
                inner += item.values()
            elif isinstance(item, list):
                inner += item
            elif isinstance(item, int) and not WHOLE_NUMBERS[0] <= item <= WHOLE_NUMBERS[1]:
                raise BadInput(
                    f"The field {field!r} holds a whole number of more than 64 bits.",
                    remedy="Write it as text.",
                )
            elif isinstance(item, str) and "\x00" in item:
                raise BadInput(f"The field {field!r} holds a NUL character.", remedy="Leave it out.")
        if count + len(inner) > MOST_VALUES:
            raise BadInput(
                f"The field {field!r} holds more than {MOST_VALUES} values.",
                remedy="Keep data in a file, and name it.",
            )
        if not inner:
            break
        level = inner
    else:
        raise BadInput(
            f"The field {field!r} is nested more than {DEEPEST} levels deep.", remedy="Flatten it."
        )
    size = len(msgspec.json.encode(value))
    if size > LARGEST_TABLE:
        raise BadInput(
            f"The field {field!r} has {size} bytes; {LARGEST_TABLE} are allowed.",
            remedy="Keep data in a file, and name it.",
        )


def _check_keys(keys: Iterable[str], field: str) -> None:
    for key in keys:
        wrong = find_misfit(key, LONGEST_NAME)
        if wrong:
            raise BadInput(f"A key in the field {field!r} {wrong}.", remedy="Rename it.")
