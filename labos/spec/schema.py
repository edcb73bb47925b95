"""JSON Schemas of the files, made from the models, for editors and other programs."""

from __future__ import annotations

from typing import Any, Literal, get_args

from labos.errors import NotFound
from labos.spec import models
from labos.spec.campaign import CampaignFile
from labos.spec.description import DescriptionFile
from labos.spec.findings import near
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
"""Tells an editor which schema a file has; its path is taken from the file's folder."""

_VERSION = "version of this language; marks a file as LabOS' own"
_PEOPLE = "for people"
_ANCHOR = "the step whose end counts"
_FROM = "where the numbers come from: a key of `sources`, `derived` or `assumed`"
_AT = "where it is, in mm, in the frame of what it is on"
_TURN = "how it is turned about x, then y, then z, in degrees"
_ON = "the part that carries it; `base` for the instrument's own frame"
_OF = "the workflow or the run of that step, if it is not this one"

_ACTION = {
    "description": _PEOPLE,
    "args": "its arguments, by name",
    "effects": "what it does to the bench: tables of one effect each, as the reference names them",
    "duration": "its nominal duration: seconds, or text as `10 min`",
    "duration_from": "where the duration is found if arguments decide it: `{seconds}`, `20 + {minutes}`",
    "safe_to_repeat": "whether doing it twice does no harm",
    "exclusive": "false for a pure query, which does not occupy the module",
    "recovers": "whether it brings the module out of an error",
    "aliases": "other names",
    "result": "the type of what it results in; empty for nothing",
    "returns": "what the simulated module returns; a file in it as `{file: name, text: content}`",
    "dangerous": "what may hurt or cannot be undone: `laser`, `hot`, `irreversible`, or another word",
}

DESCRIPTIONS: dict[str, dict[str, str]] = {
    "WorkcellFile": {
        "labos": _VERSION,
        "name": "the workcell's name: letters, digits, _, -, spaces and brackets",
        "description": _PEOPLE,
        "config": "a table of anything",
        "modules": "the instruments and arms",
        "locations": "taught places: module, station, joint values, or those of each labware type and `any`",
        "stations": "what differs from the drivers' descriptions, and places that belong to no module",
        "stock": "what stands where when the lab is first declared: station, then labware type, then count",
        "expired": "whether packs that are past their date may be used: refuse, or warn",
        "labware": "files that define labware types, or folders of them, relative to this file's folder",
        "transfers": "who carries labware where a step names no module; whatever modules can, if left out",
    },
    "Amount": {
        "amount": "how much",
        "unit": "uL, mL, L, mg, g, mm, m …; the resource's own, if left out",
    },
    "ModuleEntry": {
        "name": "the module's name, as the workcell's",
        "model": "a model that a driver serves; either this or `driver`",
        "driver": "the driver's name, if the model does not say it",
        "interface": "how the module's node is reached; LabOS' own node, if left out or `native`",
        "about": "what a foreign node offers, where no driver says it",
        "extends": "what its own node offers beyond what its driver knows; only with an `interface`",
        "config": "a table for the driver: addresses, ports",
        "coordinates": "x, y, z in metres and a quaternion, from the workcell's origin",
        "regrip": "the station where an arm changes from one grip to another",
        "resources": "capacities of consumables: a number in their own unit, or with another (20 mL)",
        "variables": "values of its variables at first",
        "rest": "values of its variables that let other runs use it",
        "zone": "the zone in which the module is whenever it acts",
        "active": "false leaves the module out",
        "retry": "how often a step on it that does not say is done again if it fails having done nothing",
        "timeout": "the time after which nobody knows how a step on it that does not say ended",
        "on_error": "what follows when a step on it fails for good that does not say itself",
        "second_person": "true: runs that do what is dangerous there wait for a second person's approval",
        "setup": "what it costs to set it up for another value of an argument",
        "together": "what it does for the labware of several runs at once",
        "comment": _PEOPLE,
    },
    "SetupEntry": {
        "by": "the argument of its actions for whose value the module is set up",
        "takes": "how much longer an action takes with another value than the last one",
        "changes": "changes that take another time",
    },
    "TogetherEntry": {
        "actions": "the actions that it carries out for all labware in it at once",
        "wait": "how long a run whose labware is in it waits for that of others, at most",
    },
    "SetupChangeEntry": {
        "from": "the value before",
        "to": "the value after",
        "takes": "how much longer an action takes that makes this change",
    },
    "About": {
        "description": _PEOPLE,
        "manipulator": "whether it carries labware",
        "stations": "its places that hold labware, by name",
        "variables": "values at first of its variables that matter to others",
        "rest": "values of its variables that let other runs use it",
        "levels": "capacities of what it uses up",
        "units": "the units of what it uses up",
        "actions": "what it can do, by name",
    },
    "ActionAbout": _ACTION,
    "ExtendedAction": {
        **_ACTION,
        "replaces": "whether it takes the place of the driver's action; if not, its arguments are added",
    },
    "Extends": {
        "stations": "places that the driver does not know, by name",
        "actions": "actions and arguments that the driver does not know, by the action's name",
    },
    "ArgAbout": {
        "type": "what it takes; `station` and `file` are names of such",
        "required": "whether it must be given; if not said: whether it has no default",
        "default": "its value if it is not given",
        "unit": "the unit of its value and limits",
        "minimum": "the least value",
        "maximum": "the greatest value",
        "choices": "the values it may have; any, if left out",
        "aliases": "other names",
        "description": _PEOPLE,
    },
    "StationAbout": {
        "kind": "what kind of place it is",
        "capacity": "how many pieces of labware it holds",
        "access": "values of the module's variables with which an arm can reach in",
        "claim": "whether labware here keeps the module from other runs",
        "aliases": "other names",
    },
    "StationEntry": {
        "kind": "what kind of place it is; a nest, if nothing else says so",
        "capacity": "how many pieces of labware it holds",
        "shelves": "how many shelves of one piece each a hotel has; arms are taught each of them",
        "transfers": "false: only steps that name their module carry labware to or from here",
        "accepts": "labware types; any, if left out",
        "access": "values of the module's variables with which an arm can reach in",
        "claim": "whether labware here keeps the module from other runs",
        "independent": "labware here and at the module's other stations do not concern each other: no claim",
        "zone": "a part of the bench that one arm may be in at a time",
        "reach": "module, then the grips it can use here, by labware type if they differ; empty for any",
        "rotation": "how far the nest is turned from the room's frame, in degrees",
        "a1": "how far labware has to be turned in the nest, in degrees; any way round, if left out",
        "observer": "the module that sees what stands here",
        "verify": "when the observer is asked whether a motion did what its module says",
        "aliases": "other names",
        "comment": _PEOPLE,
    },
    "TransferEntry": {
        "module": "who carries",
        "action": "by which of its actions",
        "source": "the action's argument that says from where",
        "target": "the action's argument that says to where",
        "cost": "of several ways the one is taken that costs least in all",
        "args": "further arguments of the action",
        "from": "it holds for transfers from these stations, in place of ways that hold for all",
        "to": "it holds for transfers to these stations, in place of ways that hold for all",
    },
    "ShelfPoses": {
        "first": "joint values at the lowest shelf",
        "step": "what is added to each of them from one shelf to the next",
    },
    "WorkflowFile": {
        "labos": _VERSION,
        "name": "the workflow's name",
        "description": _PEOPLE,
        "metadata": "a table of anything, kept with the file",
        "workcell": "the workcell it was written for; for people",
        "modules": "modules it uses; one that the workcell lacks is a warning",
        "parameters": "values it takes from the payload, by name",
        "hold": "how long modules are kept from others, by module; `none` for no longer than they must be",
        "windows": "what follows where a run can miss a window if its steps take shorter or longer",
        "steps": "the steps; each follows the one before it, if it does not say `after`",
        "on_cancel": "steps that bring labware out of the way when a run is cancelled, or a file with them",
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
    "AnyModule": {"any": "the modules that may do the step: one of them does it"},
    "StepEntry": {
        "name": "the step's name",
        "module": "the module's name; `any <driver>` or `{any: [a, b]}`: one of them; `same as <step>`",
        "action": "one of the module's actions, or an alias of it",
        "args": "the action's arguments, by name or alias; `payload.x` stands for a value of the payload",
        "use": "another workflow file, whose steps stand here; instead of `module` and `action`",
        "payload": "the payload of the file that is used; the whole payload, if left out",
        "for_each": "a list: the entry is repeated for each of its elements",
        "when": "a condition on the payload; if it is false, the entry is left out",
        "after": "names of steps that must be done first; the one before it, if left out",
        "wait": "it starts no sooner than a time after another step's end",
        "within": "it starts no later than a time after another step's end",
        "on_error": "what follows when it has failed for good",
        "expect": "a condition on its result; if it does not hold, the step has failed",
        "timeout": "the time after which nobody knows how it ended: seconds, text as `10 min`, or `none`",
        "retry": "how often it is done again if it fails without having done anything; or `none`",
        "comment": _PEOPLE,
    },
    "ForEach": {
        "item": "the name under which the entry finds the element in its payload",
        "in": "the list: `payload.plates`, or the elements themselves",
        "parallel": "whether the entry's rounds need not wait for each other",
    },
    "RetryEntry": {
        "times": "how often it is done again, 100 at most",
        "delay": "the time before it is done again: seconds, or text as `10 min`",
        "reset": "whether its module is reset before it is done again",
    },
    "RunSteps": {
        "run": "a list of steps, or a workflow file whose steps they are",
        "then": "whether the run then fails, or goes on with what follows the step",
    },
    "Wait": {
        "after": _ANCHOR,
        "of": _OF,
        "at_least": "the time that must pass: seconds, or text as `10 min`",
    },
    "Within": {
        "after": _ANCHOR,
        "of": _OF,
        "at_most": "the time within which the step starts: seconds, or text as `10 min`",
        "on_breach": "what happens when it starts too late",
    },
    "LabwareFile": {"labos": _VERSION, "labware": "labware types by name"},
    "LabwareType": {
        "description": _PEOPLE,
        "footprint": "outer size",
        "wells": "its grid of wells, if it has any",
        "grips": "the grips by which it can be held; any, if left out",
        "stackable": "false: one may not stand upon another, and no stack takes it",
        "source": "where the measures come from",
    },
    "Footprint": {
        "length_mm": "along its long side, in mm",
        "width_mm": "along its short side, in mm",
        "height_mm": "without a lid, in mm",
    },
    "Wells": {
        "rows": "how many rows: A, B …",
        "columns": "how many columns: 1, 2 …",
        "pitch_mm": "from one well's centre to the next one's, in mm",
        "a1_x_mm": "centre of A1 from the left edge, in mm",
        "a1_y_mm": "centre of A1 from the back edge, in mm",
        "volume_ul": "what a well holds, in µL",
    },
    "DescriptionFile": {
        "labos": _VERSION,
        "driver": "the driver whose instrument it is",
        "instrument": "maker and model",
        "footprint": "what it takes up at rest",
        "parts": "its rigid pieces, by name",
        "stations": "the places that hold labware; each is one of those that the driver names",
        "grips": "how its hand holds labware, by the grips' names in workcell files",
        "reach": "where its hand can be, if it carries labware",
        "limits": "what it can be set to: a number, a list of them (least and greatest), or text",
        "variants": "other sizes of it, by name",
        "sources": "where numbers come from, by the short names that `from` uses",
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
        "moves": "how it moves on what carries it; it does not, if left out",
        "shapes": "what it looks like",
    },
    "MovesEntry": {
        "from": _FROM,
        "slide_mm": "least and greatest way along the axis, in mm",
        "turn_deg": "least and greatest angle about the axis, in degrees",
        "axis": "the axis' direction in the part's own frame",
        "like": "the part whose motion it follows",
        "times": "how much of that motion it makes",
    },
    "ShapeEntry": {
        "box_mm": "sides along x, y and z, in mm",
        "cylinder_mm": "diameter, and height along z, in mm",
        "at_mm": "its middle in the part's frame, in mm",
        "turn_deg": _TURN,
        "colour": "what it is painted with",
    },
    "PlaceEntry": {
        "from": _FROM,
        "kind": "what kind of place it is, as the driver says",
        "on": _ON,
        "at_mm": "the middle of the labware's underside, in mm, in the frame of what it is on",
        "turn_deg": "how it is turned, in degrees; the labware's long side lies along x",
        "approach": "the side that a hand comes from",
        "grips": "the grips with which a hand can reach in; any, if left out",
        "each": "numbers in its name, which make a row of places of it",
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
        "on": "the part from whose z axis the distance counts; `base` for the instrument's own frame",
        "radius_mm": "least and greatest distance from that axis, in mm",
        "height_mm": "least and greatest height above the instrument's own frame, in mm",
        "rail_mm": "least and greatest way of that axis on a rail, in mm",
        "rail_axis": "the direction of the rail",
    },
    "CampaignFile": {
        "labos": _VERSION,
        "campaign": "what the campaign is called",
        "workflow": "a workflow file beside this one, or a packaged workflow",
        "workcell": "where, if the lab has several",
        "payload": "values that all rows have",
        "rows": "where the rows come from; each row is one run",
        "priority": "higher goes first",
        "due": "the key of a row that says when its run should be over: 2026-05-04T10:30, in the lab's time",
        "deadline": "when it should be over: 2026-05-04T10:30, in the lab's time unless it names a zone, or "
        "12h from now; its runs go first once time is short",
        "budget": "what it may use at most",
        "tags": "words to find it by",
        "until": "no further row is submitted once this holds for a run: steps.Read.result.od > 0.5",
        "on_failure": "go_on, stop at the first failure, or stop_after so many",
        "visibility": "who sees it, beside operators: lab (all), group (its user's), private (its user)",
    },
    "RowsEntry": {
        "table": "a CSV, YAML or JSON file beside this one; the columns are keys of the payload",
        "list": "the rows themselves",
        "grid": "keys and their values: each with each",
        "zip": "keys and their values: the first with the first, and so on",
        "latin_hypercube": "so many rows that fill a space evenly",
    },
    "LatinHypercube": {
        "samples": "how many rows",
        "seed": "the same seed gives the same rows",
        "spans": "keys, and from where to where their values go",
    },
    "Span": {
        "from": "the least value",
        "to": "the greatest value",
        "whole": "whole numbers only",
    },
    "BudgetEntry": {
        "runs": "how many runs; 0 for no limit",
        "lab_time": "module time: seconds, or text as `20 h`; 0 for no limit",
        "consumables": "amounts by kind, in the unit of each",
    },
    "StopAfter": {"stop_after": "how many rows may fail"},
    "SharesFile": {
        "labos": _VERSION,
        "groups": "groups of users, by name",
        "users": "users who are in no group, each as a group alone",
    },
    "GroupEntry": {
        "weight": "which part of the lab it is to have, beside the weights of others",
        "members": "its users, by name",
        "quota": "what they may have together",
    },
    "MemberEntry": {
        "weight": "which part of the group's share, beside the weights of its other members",
        "quota": "what the user may have",
    },
    "QuotaEntry": {
        "running": "runs under way at a time",
        "queued": "runs that wait at a time",
        "lab_hours": "module hours in seven days",
        "consumables": "amounts in seven days by kind, in the unit of each",
        "priority": "the highest priority that may be given; any, if left out",
    },
    "PolicyFile": {
        "labos": _VERSION,
        "programs": "whether what service accounts submit waits for an approval",
        "trusted": "service accounts whose submissions do not",
        "newcomers": "so many submissions of a user have to be approved before others of theirs do not wait",
        "dangerous": "whether what does something dangerous waits",
        "above": "what uses more than this waits",
        "deadlines": "whether campaigns with a deadline wait",
        "own": "whether an operator may approve what is the operator's own",
        "erasure": "whether people's words are erased only when a second admin has agreed",
        "priority": "the highest priority for users who are no operators and have no quota for it",
        "bookings": "what users who are no operators may book",
    },
    "BookingsEntry": {
        "hours": "hours of one booking; as many as all together, if left out",
        "total_hours": "hours that are booked and still to come, of all bookings together",
        "days_ahead": "so far ahead a booking may begin",
    },
    "VariantEntry": {
        "models": "names of models, as in workcell files, that are of this size",
        "instrument": "maker and model",
        "footprint": "in place of the file's",
        "parts": "in place of the file's",
        "stations": "in place of the file's",
        "grips": "in place of the file's",
        "reach": "in place of the file's",
        "limits": "in place of the file's",
    },
}
"""What each field means, by model; an editor shows it."""

ONE_OR_MANY = {"StepEntry": ("wait", "within")}
"""Fields that take one table or a list of them."""


def schema_of(kind: str) -> dict[str, Any]:
    """The JSON Schema of a kind of file. Raises NotFound."""
    if kind not in FILES:
        known = get_args(SchemaKind)
        raise NotFound(f"There is no schema of a {kind!r}.", remedy=near(kind, known, "schema"))
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
        told = DESCRIPTIONS.get(name, {}).get(field)
        if told:
            content["description"] = told
        if content.get("default", 0) is None:
            del content["default"]
    part.pop("title", None)
