"""What a request says: the JSON bodies of the routes."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.http.access import Told
from labos.http.placing import Placing
from labos.http.service import WorkflowText


class NewRun(msgspec.Struct, forbid_unknown_fields=True):
    """``place``: labware that the user has put there for the run."""

    workflow: WorkflowText
    user: str
    payload: dict[str, Any] = {}
    workcell: str = ""
    priority: int = 0
    experiment: str = ""
    place: list[Placing] = []


class NewExperiment(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    user: str
    closing: WorkflowText | None = None
    parking: list[str] = []
    payload: dict[str, Any] = {}
    workcell: str = ""
    priority: int = 0


class Note(msgspec.Struct, forbid_unknown_fields=True):
    kind: str
    name: str
    facts: dict[str, Any] = {}


class End(msgspec.Struct, forbid_unknown_fields=True):
    why: str = "ended"


class Answer(msgspec.Struct, forbid_unknown_fields=True):
    choice: str
    by: str
    note: str = ""
    result: Any = None


class Placed(msgspec.Struct, forbid_unknown_fields=True):
    station: str
    labware: str
    by: str


class Barcode(msgspec.Struct, forbid_unknown_fields=True):
    barcode: str
    by: str
    replace: bool = False


class Seen(msgspec.Struct, forbid_unknown_fields=True):
    station: str
    by: str
    what: str = ""


class Given(msgspec.Struct, forbid_unknown_fields=True):
    to: str
    by: str
    force: bool = False
    note: str = ""


class Sheet(msgspec.Struct, forbid_unknown_fields=True):
    text: str
    by: str
    name: str = "sheet"
    labware: str = ""
    station: str = ""
    replace: bool = False


class WorkcellText(msgspec.Struct, forbid_unknown_fields=True):
    """``labware`` holds the labware files that the workcell file names, as it names them."""

    text: str
    by: str
    name: str = "workcell"
    dry_run: bool = False
    labware: dict[str, bytes] = {}


class Taught(msgspec.Struct, forbid_unknown_fields=True):
    station: str
    pose: list[float]
    by: str
    why: str = ""
    labware_type: str = ""


class Entering(msgspec.Struct, forbid_unknown_fields=True):
    by: str
    why: str = ""
    park: bool = True


class Leaving(msgspec.Struct, forbid_unknown_fields=True):
    by: str
    note: str = ""
    changed: list[Told] = []


class Declared(msgspec.Struct, forbid_unknown_fields=True):
    by: str
    stations: dict[str, list[str]] = {}
    workcell: str = ""
    empty: bool = False


class By(msgspec.Struct, forbid_unknown_fields=True):
    by: str = "somebody"


class Change(By, forbid_unknown_fields=True):
    """Of a run. ``stay``: if it is cancelled, its labware stays where it is."""

    stay: bool = False


class Stop(msgspec.Struct, forbid_unknown_fields=True):
    target: str
    by: str = "somebody"


class Outage(msgspec.Struct, forbid_unknown_fields=True):
    why: str
    by: str
    until: int = 0
