"""JSON Schemas of the files, made from the models, for editors and other programs."""

from __future__ import annotations

from typing import Any, Literal, get_args

from labos.errors import NotFound
from labos.spec import models
from labos.spec.campaign import CampaignFile
from labos.spec.description import DescriptionFile
from labos.spec.findings import suggest_name
from labos.spec.parts import Part
from labos.spec.policy import PolicyFile
from labos.spec.shares import SharesFile

SchemaKind = Literal["workcell", "workflow", "labware", "description", "campaign", "shares", "policy"]
FILES: dict[SchemaKind, type[Part]] = {
    "workcell": models.WorkcellFile,
    "workflow": models.WorkflowFile,
    "labware": models.LabwareFile,
    "description": DescriptionFile,
    "campaign": CampaignFile,
    "shares": SharesFile,
    "policy": PolicyFile,
}
DRAFT = "https://json-schema.org/draft/2020-12/schema"
MODELINE = "# yaml-language-server: $schema="
"""The comment that names a file's schema for an editor; its path is relative to the file's folder."""

_VERSION = "version of this language; marks a file as LabOS' own"
_PEOPLE = "for people"
_ANCHOR = "the step whose end counts"
_FROM = "the source of the numbers: a key of `sources`, `derived` or `assumed`"
_AT = "its position in mm, in the frame of the part that carries it"
_TURN = "its rotation about x, then y, then z, in degrees"
_ON = "the part that carries it; `base` for the instrument's own frame"
_OF = "the workflow or the run of that step, if it is not this one"

_ACTION = {
    "description": _PEOPLE,
    "args": "its arguments, by name",
    "effects": "its effects on the bench: tables with one effect each, as in the reference",
    "duration": "its nominal duration: seconds, or text such as `10 min`",
    "duration_from": "the formula for the duration if it depends on arguments: `{seconds}`, `20 + {minutes}`",
    "safe_to_repeat": "whether it can be repeated without harm",
    "exclusive": "false for a pure query, which does not occupy the module",
    "recovers": "whether it recovers the module from an error",
    "aliases": "other names",
    "result": "the type of its result; empty for none",
    "returns": "the result of the simulated module; a file in it as `{file: name, text: content}`",
    "dangerous": "its danger: `laser`, `hot`, `irreversible`, or another word",
}

DESCRIPTIONS: dict[str, dict[str, str]] = {
    "WorkcellFile": {
        "labos": _VERSION,
        "name": "the workcell's name: letters, digits, _, -, spaces and brackets",
        "description": _PEOPLE,
        "config": "a table of anything",
        "modules": "the instruments and arms",
        "locations": "taught places: module, station, joint values, or those of each labware type and `any`",
        "stations": "differences from the drivers' descriptions, and stations that belong to no module",
        "stock": "the labware when the lab is first declared: station, then labware type, then count",
        "expired": "whether packs may be used after their expiry date: refuse, or warn",
        "labware": "files that define labware types, or folders of them, relative to this file's folder",
        "transfers": "how labware is moved if a step names no module; any possible way, if left out",
    },
    "Amount": {
        "amount": "the amount",
        "unit": "uL, mL, L, mg, g, mm, m …; the unit of the resource, if left out",
    },
    "ModuleEntry": {
        "name": "the module's name, as the workcell's",
        "model": "a model of a driver; either this or `driver`",
        "driver": "the driver's name, if the model does not determine it",
        "interface": "the protocol of the module's node; LabOS' own, if left out or `native`",
        "about": "the description of a foreign node without a driver",
        "extends": "parts of its own node that its driver does not have; only with an `interface`",
        "config": "a table for the driver: addresses, ports",
        "coordinates": "x, y, z in metres and a quaternion, from the workcell's origin",
        "regrip": "the station where an arm changes from one grip to another",
        "resources": "capacities of consumables: a number in their own unit, or with another (20 mL)",
        "variables": "first values of its variables",
        "rest": "values of its variables at which other runs can use it",
        "zone": "the zone in which the module acts",
        "active": "false leaves the module out",
        "retry": "the default number of retries of a step on it that failed without any effect",
        "timeout": "the default time after which the outcome of a step on it counts as unknown",
        "on_error": "the default reaction when a step on it has finally failed",
        "second_person": "true: runs with dangerous steps there wait for a second person's approval",
        "setup": "the time for setting it up for another value of an argument",
        "together": "actions for the labware of several runs at once",
        "comment": _PEOPLE,
    },
    "SetupEntry": {
        "by": "the argument of its actions for whose value the module is set up",
        "takes": "the additional time of an action with another value than the last one",
        "changes": "changes with their own times",
    },
    "TogetherEntry": {
        "actions": "the actions that it carries out for all labware in it at once",
        "wait": "how long a run whose labware is in it waits for that of others, at most",
    },
    "SetupChangeEntry": {
        "from": "the value before",
        "to": "the value after",
        "takes": "the additional time of an action with this change",
    },
    "About": {
        "description": _PEOPLE,
        "manipulator": "whether it moves labware",
        "stations": "its places that hold labware, by name",
        "variables": "first values of its variables that matter to others",
        "rest": "values of its variables at which other runs can use it",
        "levels": "capacities of its resources",
        "units": "the units of its resources",
        "actions": "its actions, by name",
    },
    "ActionAbout": _ACTION,
    "ExtendedAction": {
        **_ACTION,
        "replaces": "whether it replaces the driver's action; if not, its arguments are added",
    },
    "Extends": {
        "stations": "places that the driver does not have, by name",
        "actions": "actions and arguments that the driver does not have, by the action's name",
    },
    "ArgAbout": {
        "type": "its type; `station` and `file` are names of such",
        "required": "whether it must be given; by default: whether it has no default value",
        "default": "its value if it is not given",
        "unit": "the unit of its value and limits",
        "minimum": "the least value",
        "maximum": "the greatest value",
        "choices": "the values it may have; any, if left out",
        "aliases": "other names",
        "description": _PEOPLE,
    },
    "StationAbout": {
        "kind": "the kind of the station",
        "capacity": "its capacity for pieces of labware",
        "access": "values of the module's variables with which an arm can reach in",
        "claim": "whether labware here blocks the module for other runs",
        "aliases": "other names",
    },
    "StationEntry": {
        "kind": "the kind of the station; `nest` by default",
        "capacity": "its capacity for pieces of labware",
        "shelves": "the number of shelves of a hotel, for one piece each; arms are taught each of them",
        "transfers": "false: only steps that name their module move labware to or from here",
        "accepts": "labware types; any, if left out",
        "access": "values of the module's variables with which an arm can reach in",
        "claim": "whether labware here blocks the module for other runs",
        "independent": "labware here does not claim the module",
        "zone": "a part of the bench in which only one arm may be at a time",
        "reach": "module, then its possible grips here, by labware type if they differ; empty for any",
        "rotation": "the rotation of the nest in the room's frame, in degrees",
        "a1": "the required rotation of labware in the nest, in degrees; any, if left out",
        "observer": "the module that can see this station",
        "verify": "when the observer checks whether a move succeeded",
        "aliases": "other names",
        "comment": _PEOPLE,
    },
    "TransferEntry": {
        "module": "the module that moves labware",
        "action": "the action of the module",
        "source": "the action's argument for the source",
        "target": "the action's argument for the target",
        "cost": "the way with the least total cost is used",
        "args": "further arguments of the action",
        "from": "only for transfers from these stations; takes precedence over entries for all stations",
        "to": "only for transfers to these stations; takes precedence over entries for all stations",
    },
    "ShelfPoses": {
        "first": "joint values at the lowest shelf",
        "step": "the increments from one shelf to the next",
    },
    "WorkflowFile": {
        "labos": _VERSION,
        "name": "the workflow's name",
        "description": _PEOPLE,
        "metadata": "a table of anything, kept with the file",
        "workcell": "the workcell for which it was written; for people",
        "modules": "the modules that it uses; a module that the workcell does not have causes a warning",
        "parameters": "the values that it takes from the payload, by name",
        "hold": "how long modules are reserved for the run, by module; `none` for no longer than necessary",
        "windows": "the reaction if a run can miss a window when its steps take shorter or longer",
        "steps": "the steps; without `after`, each follows the previous one",
        "on_cancel": "steps that clear labware away when a run is cancelled, or a file with them",
    },
    "HoldEntry": {
        "from": "the step whose start begins it",
        "until": "the step whose end ends it",
    },
    "Parameter": {
        "default": "the value if the payload holds none",
        "required": "whether the payload must hold it",
        "description": _PEOPLE,
    },
    "AnyModule": {"any": "the modules that can do the step; one of them is chosen"},
    "StepEntry": {
        "name": "the step's name",
        "module": "the module's name; `any <driver>` or `{any: [a, b]}`: one of them; `same as <step>`",
        "action": "one of the module's actions, or an alias of it",
        "args": "the action's arguments, by name or alias; `payload.x` stands for a value of the payload",
        "use": "another workflow file, whose steps replace this entry; instead of `module` and `action`",
        "payload": "the payload of the file that is used; the whole payload, if left out",
        "for_each": "a list: the entry is repeated for each of its elements",
        "when": "a condition on the payload; if it is false, the entry is left out",
        "after": "names of steps that must be done first; the one before it, if left out",
        "wait": "it starts no sooner than a time after another step's end",
        "within": "it starts no later than a time after another step's end",
        "on_error": "the reaction when it has finally failed",
        "expect": "a condition on its result; if it is false, the step has failed",
        "timeout": "the time after which its outcome is unknown: seconds, text such as `10 min`, or `none`",
        "retry": "the retries after a failure without any effect; or `none`",
        "comment": _PEOPLE,
    },
    "ForEach": {
        "item": "the name of the element in the entry's payload",
        "in": "the list: `payload.plates`, or the elements themselves",
        "parallel": "whether the entry's rounds need not wait for each other",
    },
    "RetryEntry": {
        "times": "the number of retries, at most 100",
        "delay": "the time before a retry: seconds, or text such as `10 min`",
        "reset": "whether its module is reset before a retry",
    },
    "RunSteps": {
        "run": "a list of steps, or a workflow file whose steps they are",
        "then": "whether the run then fails, or continues with the steps after it",
    },
    "Wait": {
        "after": _ANCHOR,
        "of": _OF,
        "at_least": "the time that must pass: seconds, or text such as `10 min`",
    },
    "Within": {
        "after": _ANCHOR,
        "of": _OF,
        "at_most": "the time within which the step starts: seconds, or text such as `10 min`",
        "on_breach": "the reaction when it starts too late",
    },
    "LabwareFile": {"labos": _VERSION, "labware": "labware types by name"},
    "LabwareType": {
        "description": _PEOPLE,
        "footprint": "outer size",
        "wells": "its grid of wells, if it has any",
        "grips": "the possible grips; any, if left out",
        "stackable": "false: no piece may stand on another, and no stack accepts it",
        "source": "the source of the measures",
    },
    "Footprint": {
        "length_mm": "along its long side, in mm",
        "width_mm": "along its short side, in mm",
        "height_mm": "without a lid, in mm",
    },
    "Wells": {
        "rows": "the number of rows: A, B …",
        "columns": "the number of columns: 1, 2 …",
        "pitch_mm": "from one well's centre to the next one's, in mm",
        "a1_x_mm": "centre of A1 from the left edge, in mm",
        "a1_y_mm": "centre of A1 from the back edge, in mm",
        "volume_ul": "the capacity of a well, in µL",
    },
    "DescriptionFile": {
        "labos": _VERSION,
        "driver": "the driver of the instrument",
        "instrument": "maker and model",
        "footprint": "its space at rest",
        "parts": "its rigid pieces, by name",
        "stations": "the places that hold labware; each is a station of the driver",
        "grips": "how its gripper holds labware, by the names of grips in workcell files",
        "reach": "the reach of its gripper, if it moves labware",
        "limits": "limits of its settings: a number, a list of them (least and greatest), or text",
        "variants": "other sizes of it, by name",
        "sources": "the sources of numbers, by the short names for `from`",
        "notes": _PEOPLE,
    },
    "FootprintEntry": {
        "from": _FROM,
        "size_mm": "along x and along y, in mm",
        "height_mm": "at rest, in mm",
        "middle_mm": "x and y of its middle, in mm",
    },
    "PartEntry": {
        "from": _FROM,
        "on": _ON,
        "at_mm": _AT,
        "turn_deg": _TURN,
        "moves": "its motion on the part that carries it; none if left out",
        "shapes": "its shapes",
    },
    "MovesEntry": {
        "from": _FROM,
        "slide_mm": "least and greatest position along the axis, in mm",
        "turn_deg": "least and greatest angle about the axis, in degrees",
        "axis": "the axis' direction in the part's own frame",
        "like": "the part whose motion it follows",
        "times": "the factor of that motion",
    },
    "ShapeEntry": {
        "box_mm": "sides along x, y and z, in mm",
        "cylinder_mm": "diameter, and height along z, in mm",
        "at_mm": "its middle in the part's frame, in mm",
        "turn_deg": _TURN,
        "colour": "its colour",
    },
    "PlaceEntry": {
        "from": _FROM,
        "kind": "the kind of the station, as in the driver",
        "on": _ON,
        "at_mm": "the middle of the labware's underside, in mm, in the frame of the part that carries it",
        "turn_deg": "its rotation in degrees; the labware's long side lies along x",
        "approach": "the side from which a gripper comes",
        "grips": "the possible grips; any, if left out",
        "each": "numbers in its name, which make it a row of places",
        "note": _PEOPLE,
    },
    "EachEntry": {
        "from_to": "the first and the last number",
        "step_mm": "from one place to the next, in mm",
    },
    "GripEntry": {
        "from": _FROM,
        "width_mm": "width between the fingers, closed on labware and open, in mm",
        "note": _PEOPLE,
    },
    "ReachEntry": {
        "from": _FROM,
        "on": "the part from whose z axis the distance is measured; `base` for the instrument's own frame",
        "radius_mm": "least and greatest distance from that axis, in mm",
        "height_mm": "least and greatest height above the instrument's own frame, in mm",
        "rail_mm": "least and greatest position of that axis on a rail, in mm",
        "rail_axis": "the direction of the rail",
    },
    "CampaignFile": {
        "labos": _VERSION,
        "campaign": "the campaign's name",
        "workflow": "a workflow file beside this one, or a packaged workflow",
        "workcell": "the workcell, if the lab has several",
        "payload": "values that all rows have",
        "rows": "the source of the rows; each row is one run",
        "priority": "higher goes first",
        "due": "the key with the due date of a row's run: 2026-05-04T10:30, in the lab's time",
        "deadline": "the time by which it should end: 2026-05-04T10:30, in the lab's time unless it names "
        "a zone, or 12h from now; its runs go first when time is short",
        "budget": "the most that it may use",
        "tags": "keywords for finding it",
        "until": "no further row is submitted after this is true for a run: steps.Read.result.od > 0.5",
        "on_failure": "go_on, stop at the first failure, or stop_after a number of failures",
        "visibility": "who sees it besides operators: lab (all), group (its user's), private (only its user)",
    },
    "RowsEntry": {
        "table": "a CSV, YAML or JSON file beside this one; the columns are keys of the payload",
        "list": "the rows themselves",
        "grid": "keys and their values: all combinations",
        "zip": "keys and their values: the first with the first, and so on",
        "latin_hypercube": "rows that fill a space evenly",
    },
    "LatinHypercube": {
        "samples": "how many rows",
        "seed": "the same seed gives the same rows",
        "spans": "keys, and the spans of their values",
    },
    "Span": {
        "from": "the least value",
        "to": "the greatest value",
        "whole": "whole numbers only",
    },
    "BudgetEntry": {
        "runs": "the largest number of runs; 0 for no limit",
        "lab_time": "module time: seconds, or text as `20 h`; 0 for no limit",
        "consumables": "amounts by kind, in the unit of each",
    },
    "StopAfter": {"stop_after": "the number of failed rows after which no further row is submitted"},
    "SharesFile": {
        "labos": _VERSION,
        "groups": "groups of users, by name",
        "users": "users who are in no group, each as a group alone",
    },
    "GroupEntry": {
        "weight": "its share of the lab, relative to the weights of others",
        "members": "its users, by name",
        "quota": "their common limits",
    },
    "MemberEntry": {
        "weight": "the user's part of the group's share, relative to the weights of its other members",
        "quota": "the user's limits",
    },
    "QuotaEntry": {
        "running": "started runs at the same time",
        "queued": "waiting runs at the same time",
        "lab_hours": "module hours in seven days",
        "consumables": "amounts in seven days by kind, in the unit of each",
        "priority": "the highest priority that may be given; any, if left out",
    },
    "PolicyFile": {
        "labos": _VERSION,
        "programs": "whether submissions of service accounts need an approval",
        "trusted": "service accounts whose submissions need no approval",
        "newcomers": "the number of a user's approved submissions after which others need no approval",
        "dangerous": "whether submissions with dangerous steps need an approval",
        "above": "submissions that use more than this need an approval",
        "deadlines": "whether campaigns with a deadline need an approval",
        "own": "whether operators may approve their own submissions",
        "erasure": "whether people's words are erased only after a second admin has agreed",
        "priority": "the highest priority for users who are not operators and have no quota for it",
        "bookings": "limits for bookings of users who are not operators",
    },
    "BookingsEntry": {
        "hours": "hours of one booking; as many as for all together, if left out",
        "total_hours": "future hours of all bookings together",
        "days_ahead": "the number of days in advance within which a booking may begin",
    },
    "VariantEntry": {
        "models": "names of models in workcell files with this size",
        "instrument": "maker and model",
        "footprint": "replaces the file's footprint",
        "parts": "replace the file's parts",
        "stations": "replace the file's stations",
        "grips": "replace the file's grips",
        "reach": "replaces the file's reach",
        "limits": "replace the file's limits",
    },
}
"""The meaning of each field, by model; an editor shows it."""

ONE_OR_MANY = {"StepEntry": ("wait", "within")}
"""Fields that take one table or a list of them."""


def make_schema(kind: str) -> dict[str, Any]:
    """The JSON Schema of a kind of file. Raises NotFound."""
    if kind not in FILES:
        known = get_args(SchemaKind)
        raise NotFound(f"There is no schema of a {kind!r}.", remedy=suggest_name(kind, known, "schema"))
    model = FILES[kind]
    schema = model.model_json_schema()
    for name, part in (*schema.get("$defs", {}).items(), (model.__name__, schema)):
        _describe(name, part)
    head = {"$schema": DRAFT, "$id": f"urn:labos:schema:{kind}:1", "title": f"LabOS {kind}"}
    return {**head, **{key: value for key, value in schema.items() if key != "title"}}


def _describe(name: str, part: dict[str, Any]) -> None:
    part["description"] = str(part.get("description", "")).replace("``", "`").replace("\n", " ")
    for field, content in part["properties"].items():
        content.pop("title", None)
        if field in ONE_OR_MANY.get(name, ()):
            items = content.pop("items")
            content.pop("type")
            content["anyOf"] = [items, {"type": "array", "items": items}]
        description = DESCRIPTIONS.get(name, {}).get(field)
        if description:
            content["description"] = description
        if content.get("default", 0) is None:
            del content["default"]
    part.pop("title", None)
