"""What a request says: the JSON bodies of the routes."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from labos.http.access import Told
from labos.http.limits import (
    MOST_ENTRIES,
    FileName,
    Files,
    FileText,
    Line,
    Name,
    Named,
    Names,
    Person,
    Pose,
    Priority,
    SheetText,
    Time,
    Words,
)
from labos.http.placing import Placing
from labos.http.service import WorkflowText


class NewRun(msgspec.Struct, forbid_unknown_fields=True):
    """``place``: labware that the user has put there for the run."""

    workflow: WorkflowText
    user: Person
    payload: dict[str, Any] = {}
    workcell: Name = ""
    priority: Priority = 0
    experiment: Name = ""
    place: Annotated[list[Placing], msgspec.Meta(max_length=MOST_ENTRIES)] = []


class NewExperiment(msgspec.Struct, forbid_unknown_fields=True):
    name: Name
    user: Person
    closing: WorkflowText | None = None
    parking: Names = []
    payload: dict[str, Any] = {}
    workcell: Name = ""
    priority: Priority = 0


class Note(msgspec.Struct, forbid_unknown_fields=True):
    kind: Name
    name: Name
    facts: dict[str, Any] = {}


class End(msgspec.Struct, forbid_unknown_fields=True):
    why: Line = "ended"


class Answer(msgspec.Struct, forbid_unknown_fields=True):
    choice: Name
    by: Person
    note: Words = ""
    result: Any = None


class Placed(msgspec.Struct, forbid_unknown_fields=True):
    station: Name
    labware: Name
    by: Person


class Barcode(msgspec.Struct, forbid_unknown_fields=True):
    barcode: Name
    by: Person
    replace: bool = False


class Seen(msgspec.Struct, forbid_unknown_fields=True):
    station: Name
    by: Person
    what: Name = ""


class Given(msgspec.Struct, forbid_unknown_fields=True):
    to: Name
    by: Person
    force: bool = False
    note: Words = ""


class Sheet(msgspec.Struct, forbid_unknown_fields=True):
    text: SheetText
    by: Person
    name: FileName = "sheet"
    labware: Name = ""
    station: Name = ""
    replace: bool = False


class WorkcellText(msgspec.Struct, forbid_unknown_fields=True):
    """``labware`` holds the labware files that the workcell file names, ``files`` the others (tables of
    drivers), by the names that it has for them: nothing else is read."""

    text: FileText
    by: Person
    name: FileName = "workcell"
    dry_run: bool = False
    labware: Files = {}
    files: Files = {}


class Taught(msgspec.Struct, forbid_unknown_fields=True):
    station: Name
    pose: Pose
    by: Person
    why: Line = ""
    labware_type: Name = ""


class Entering(msgspec.Struct, forbid_unknown_fields=True):
    by: Person
    why: Line = ""
    park: bool = True


class Leaving(msgspec.Struct, forbid_unknown_fields=True):
    by: Person
    note: Words = ""
    changed: Annotated[list[Told], msgspec.Meta(max_length=MOST_ENTRIES)] = []


class Declared(msgspec.Struct, forbid_unknown_fields=True):
    by: Person
    stations: Named = {}
    workcell: Name = ""
    empty: bool = False


class By(msgspec.Struct, forbid_unknown_fields=True):
    by: Person = "somebody"


class Trace(By, forbid_unknown_fields=True):
    """Whether a node writes down every byte on its device's wires."""

    on: bool = True


class Change(By, forbid_unknown_fields=True):
    """Of a run. ``stay``: if it is cancelled, its labware stays where it is; ``why``: a word about it."""

    stay: bool = False
    why: Line = ""


class Stop(msgspec.Struct, forbid_unknown_fields=True):
    """Who asks is no reason to refuse an emergency stop: ``named_in_emergency`` makes a name of it."""

    target: Name
    said_by: str = msgspec.field(name="by", default="somebody")


class Outage(msgspec.Struct, forbid_unknown_fields=True):
    why: Line
    by: Person
    until: Time = 0
