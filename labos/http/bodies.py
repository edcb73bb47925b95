"""The JSON bodies of requests."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from labos.core.decide.composites import MOST_RUNS
from labos.core.signatures import Meaning
from labos.core.suggestions import MOST_STEPS
from labos.core.viewer import Visibility
from labos.http.access import StationChange
from labos.http.limits import (
    MOST_ENTRIES,
    MOST_TAGS,
    WHO_ASKS,
    WHOLE_NUMBERS,
    Amount,
    Asker,
    FileContent,
    FileName,
    Files,
    FileText,
    Line,
    Name,
    Named,
    Names,
    Pose,
    Priority,
    Secret,
    SheetText,
    Time,
    Words,
    says,
)
from labos.http.placing import Placing
from labos.http.service import WorkflowText

Limit = Annotated[int, msgspec.Meta(ge=0, le=WHOLE_NUMBERS[1])]
Amounts = Annotated[dict[Name, Amount], msgspec.Meta(max_length=MOST_ENTRIES)]
Placings = Annotated[list[Placing], msgspec.Meta(max_length=MOST_ENTRIES)]
Tags = Annotated[list[Name], msgspec.Meta(max_length=MOST_TAGS)]

WAITS = says("wait for an approval, also if the policy does not require one")


class Asked(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A request in which a user is named."""

    by: Asker = ""


class NewRun(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A run of a workflow."""

    workflow: Annotated[WorkflowText, says("the workflow, with the files that it names")]
    user: Asker = ""
    payload: Annotated[dict[str, Any], says("values for the workflow")] = {}
    workcell: Annotated[Name, says("needed if the lab has several")] = ""
    priority: Annotated[Priority, says("higher goes first; 0")] = 0
    experiment: Annotated[
        Name, says("the experiment to which the run belongs; it must belong to the same user")
    ] = ""
    place: Annotated[
        Placings, says("labware that was put on the bench for the run; recorded with the run, or not at all")
    ] = []
    propose: Annotated[bool, WAITS] = False
    due: Annotated[
        Line,
        says("the time by which the run should end: a time, or a duration from now (`12h`); empty: none"),
    ] = ""


class NewRuns(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A run of a workflow for each payload."""

    workflow: Annotated[WorkflowText, says("the workflow, with the files that it names")]
    payloads: Annotated[
        list[dict[str, Any]],
        msgspec.Meta(min_length=1, max_length=MOST_RUNS),
        says("values for the workflow, of one run each"),
    ]
    user: Asker = ""
    workcell: Annotated[Name, says("needed if the lab has several")] = ""
    priority: Annotated[Priority, says("higher goes first; 0")] = 0
    experiment: Annotated[Name, says("the experiment to which they belong; it must be the user's")] = ""
    place: Annotated[
        Placings,
        says("labware that was put on the bench for them; recorded once with the runs, or not at all"),
    ] = []
    propose: Annotated[bool, WAITS] = False
    due: Annotated[
        Line, says("the time by which they should end: a time, or a duration from now (`12h`); empty: none")
    ] = ""
    keys: Annotated[
        list[Name],
        msgspec.Meta(max_length=MOST_RUNS),
        says(
            "a key for each run; a repeated key is the same run; left out: the request's key with `-0`, "
            "`-1` …"
        ),
    ] = []
    files: Annotated[
        list[Names],
        msgspec.Meta(max_length=MOST_RUNS),
        says("for each run, the names of the workflow's files that it has; left out: all of them"),
    ] = []
    first: Annotated[
        Limit, says("the number of payloads sent before these; error messages count them too")
    ] = 0


class NewExperiment(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    name: Annotated[Name, says("its name")]
    user: Asker = ""
    closing: Annotated[
        WorkflowText | None,
        says("the workflow that clears away the labware which the experiment leaves parked"),
    ] = None
    parking: Annotated[
        Names,
        says("stations where the experiment may leave labware between its runs; left out: everywhere"),
    ] = []
    payload: Annotated[dict[str, Any], says("values for the closing workflow")] = {}
    workcell: Annotated[Name, says("needed if the lab has several")] = ""
    priority: Annotated[Priority, says("of its runs; 0")] = 0
    propose: Annotated[bool, WAITS] = False


class ExperimentNote(msgspec.Struct, forbid_unknown_fields=True):
    kind: Annotated[
        Name, says("`loop_started`, `loop_ended`, `decision`, `compute` and the like, as events.md says")
    ]
    name: Annotated[Name, says("its name")]
    facts: Annotated[dict[str, Any], says("a table of anything")] = {}
    key: Annotated[
        Name, says("identifies the call in the application; a second note with the same key is ignored")
    ] = ""


class ExperimentResumption(msgspec.Struct, forbid_unknown_fields=True):
    name: Annotated[Name, says("the experiment's name, as it was started")]


class NewFile(msgspec.Struct, forbid_unknown_fields=True):
    content: Annotated[FileContent, says("the file, in base64")]


class ExperimentEnd(msgspec.Struct, forbid_unknown_fields=True):
    why: Annotated[Line, says("a comment")] = "ended"


class NewCampaign(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    text: Annotated[FileText, says("the campaign file")]
    workflow: Annotated[WorkflowText, says("the workflow, with the files that it names")]
    user: Asker = ""
    name: Annotated[FileName, says("the name of the file in error messages")] = "campaign"
    files: Annotated[
        Files, says("the table file of the campaign, in base64, by the name that the campaign file uses")
    ] = {}
    dry_run: Annotated[bool, says("only check it")] = False
    propose: Annotated[bool, WAITS] = False


class CampaignPause(Asked, kw_only=True):
    why: Annotated[Line, says("a reason or comment for the log")] = ""


class CampaignCancel(CampaignPause, kw_only=True):
    stay: Annotated[bool, says("labware of its runs stays where it is")] = False


class Amendment(Asked, kw_only=True):
    """Fields that are left out do not change."""

    priority: Annotated[Priority | None, says("the priority of rows that are submitted from now on")] = None
    deadline: Annotated[Line | None, says("a time, or a duration from now (`12h`); empty for none")] = None
    runs: Annotated[Limit | None, says("the largest number of runs; 0 for no limit")] = None
    lab_time_s: Annotated[Amount | None, says("the most module time, in lab seconds; 0 for no limit")] = None
    consumables: Annotated[Amounts | None, says("the largest amounts, by kind of consumable")] = None
    tags: Annotated[Tags | None, says("its tags; they replace the present ones")] = None
    until: Annotated[Line | None, says("the stop rule; empty for none")] = None
    stop_after: Annotated[
        Limit | None, says("the number of failed runs at which the campaign stops; 0 for no limit")
    ] = None


class Clone(Amendment, kw_only=True):
    """Fields that are left out are copied from the campaign, except the deadline: the clone has none."""

    name: Annotated[Line, says("the name of the new campaign; empty: the name of the original")] = ""
    visibility: Annotated[Visibility | None, says("who sees it: lab, group or private")] = None
    dry_run: Annotated[bool, says("only check it")] = False
    propose: Annotated[bool, WAITS] = False


class Archiving(Asked, kw_only=True):
    undo: Annotated[bool, says("show it in lists again")] = False


class SharesFile(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    text: Annotated[FileText, says("the file")]
    by: Asker = ""
    name: Annotated[FileName, says("the name of the file in error messages")] = "shares"


class SuggestedStep(msgspec.Struct, forbid_unknown_fields=True):
    run: Annotated[Name, says("a run's id")]
    step: Annotated[int, msgspec.Meta(ge=0, le=100_000, description="which of its steps, counted from 0")]
    start: Annotated[Time, says("when it should start (UTC ns)")]
    outside: Annotated[bool, says("the run waits outside until then, and does not block others")] = False


class OrderSuggestion(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    steps: Annotated[
        list[SuggestedStep],
        msgspec.Meta(
            max_length=MOST_STEPS,
            description="the steps, in any order; neither steps nor a line: withdraw the suggestion",
        ),
    ]
    until: Annotated[Time, says("the time until which it is valid (UTC ns)")]
    position: Annotated[Time, says("the position of the log from which it was computed")] = 0
    line: Annotated[
        list[Name],
        msgspec.Meta(
            max_length=MOST_STEPS,
            description="in place of steps, for runs with windows: an order of runs with which the lab's "
            "own search for an order begins",
        ),
    ] = []
    by: Asker = ""


class InterventionAnswer(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    choice: Annotated[Name, says("the name of one of its answers")]
    by: Asker = ""
    note: Annotated[Words, says("a comment")] = ""
    result: Annotated[
        Any, says("the measured result of the completed step; required if later steps read it")
    ] = None


class BarcodeLabel(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    barcode: Annotated[Name, says("the text of the barcode")]
    by: Asker = ""
    replace: Annotated[bool, says("replace another barcode, because the label was changed")] = False


class Observation(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    station: Annotated[Name, says("the station")]
    by: Asker = ""
    what: Annotated[
        Name, says("`empty`, a number, labware by its id or barcode, or a labware type; left out: something")
    ] = ""


class Handover(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    to: Annotated[Name, says("`user:NAME`, `experiment:E3` or `shared`")]
    by: Asker = ""
    force: Annotated[bool, says("for operators: the labware belongs to somebody else")] = False
    note: Annotated[Words, says("a reason or comment; required with `force`")] = ""


class SampleSheet(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    text: Annotated[SheetText, says("the sheet, CSV")]
    by: Asker = ""
    name: Annotated[FileName, says("the name of the sheet in error messages")] = "sheet"
    labware: Annotated[Name, says("the plate, if the sheet does not name it")] = ""
    station: Annotated[Name, says("or where it stands")] = ""
    replace: Annotated[bool, says("replace an earlier sheet")] = False


class WorkcellFile(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """``labware`` holds the labware files that the workcell file names, ``files`` the others (tables of
    drivers), by the names that it has for them: nothing else is read."""

    text: Annotated[FileText, says("the file")]
    by: Asker = ""
    name: Annotated[FileName, says("the name of the file in error messages")] = "workcell"
    dry_run: Annotated[bool, says("only answer what would change")] = False
    labware: Annotated[
        Files, says("the labware files that it names, in base64, by the names that it uses")
    ] = {}
    files: Annotated[Files, says("the other files that it names: tables of drivers (`plc: hatch.yaml`)")] = {}


class NewPose(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    station: Annotated[Name, says("the station")]
    pose: Annotated[Pose, says("the numbers of the pose, as many as in the present pose")]
    by: Asker = ""
    why: Annotated[Line, says("a comment for the log")] = ""
    labware_type: Annotated[
        Name, says("the pose is only for labware of this type; the station needs a pose for all types first")
    ] = ""


class NewCalibration(Asked, kw_only=True):
    what: Annotated[
        Name, says("the calibrated part or quantity, such as `volume`; empty for the whole module")
    ] = ""
    certificate: Annotated[Name, says("the certificate's number")] = ""
    report: Annotated[FileContent, says("the report, in base64; kept with the lab's files")] = b""
    until: Annotated[Name, says("the last day on which it is valid, such as `2027-01-01` (UTC)")] = ""
    why: Annotated[Line, says("a comment for the log")] = ""


class AccessRequest(Asked, kw_only=True):
    why: Annotated[Line, says("what for")] = ""
    park: Annotated[bool, says("false: arms stay where they are")] = True


class AccessEnd(Asked, kw_only=True):
    note: Annotated[Words, says("a comment for the log")] = ""
    changed: Annotated[
        list[StationChange],
        msgspec.Meta(max_length=MOST_ENTRIES),
        says("the stations that were changed, and what stands there now"),
    ] = []


class BenchDeclaration(Asked, kw_only=True):
    stations: Annotated[Named, says("types of labware by station")] = {}
    workcell: Annotated[Name, says("the workcell for `empty`, if the lab has several")] = ""
    empty: Annotated[bool, says("all stations that were not reported are empty")] = False


class By(msgspec.Struct, forbid_unknown_fields=True):
    by: Asker = "somebody"


class WireTrace(By):
    """Whether a node writes down every byte on its device's wires."""

    on: Annotated[bool, says("true or left out: start a transcript in a new file; false: stop it")] = True


class RunCancel(By):
    """The run ends when its actions in flight have ended."""

    stay: Annotated[
        bool, says("labware stays where it is, even if the workflow has steps under `on_cancel`")
    ] = False
    why: Annotated[Line, says("a reason or comment for the log")] = ""


class RunSignature(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The record of a run, an experiment or a campaign is signed, by the user who asks."""

    meaning: Annotated[Meaning, says("`authored`, `responsible`, `reviewed`, `approved` or `rejected`")]
    password: Annotated[Secret, says("the user's password")]
    why: Annotated[Line, says("a comment, for the log")] = ""


class RunPause(By):
    """No more steps of a run are to start until it is resumed."""

    why: Annotated[Line, says("a reason or comment for the log")] = ""


class EmergencyStop(msgspec.Struct, forbid_unknown_fields=True):
    """An emergency stop is never refused because of the user's name: ``named_in_emergency`` makes a valid
    name of it."""

    target: Annotated[Name, says("a module, a workcell, or `*` for everything")]
    said_by: Annotated[str, WHO_ASKS] = msgspec.field(name="by", default="somebody")


class OutOfService(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    why: Annotated[Line, says("the reason")]
    by: Asker = ""
    until: Annotated[
        Time,
        says("the time at which it is in service again (UTC nanoseconds); 0: when a person puts it back"),
    ] = 0
