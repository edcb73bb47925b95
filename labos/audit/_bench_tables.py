"""The tables of the bench: labware, liquids, samples and resources."""

from __future__ import annotations

from labos.audit._columns import (
    ACTION,
    AT,
    LABWARE,
    MODULE,
    POSITION,
    RUN,
    Table,
    by_people,
    flag,
    json,
    number,
    text,
    time,
    whole,
)

LABWARE_TABLE = Table(
    "labware",
    "Every piece of labware that ever got a name, as it is now or was when it left.",
    ("labware",),
    (
        LABWARE,
        text("type", "Its type."),
        text("station", "Where it stands; empty if it is gone, lies on a plate, or that is not known."),
        text("lies_on", "The plate that it lies on as a lid; empty if on none."),
        text("lid", "The lid that lies on it; empty if none does."),
        json("maybe", "Places where it may be while that is not known; null if it is."),
        text("owner", "`run:…`, `experiment:…`, `user:…`, `shared`, or empty for nobody."),
        text("barcode", "What was read last; empty if nothing was."),
        text("lot", "The lot that it came from; empty if nobody said."),
        json("variables", "What else is known of it, such as `sealed`."),
        json("samples", "Samples by well, as its last sheet said."),
        time("placed_at", "When it got its name."),
        time("gone_at", "When it left the bench; null if it is there."),
        text("gone", "Why it left; empty if it is there."),
        whole("placed_position", "Where in the log it got its name."),
        whole("gone_position", "Where in the log it left; null if it is there."),
    ),
    view="labware",
    indexes=(("lot",), ("barcode",)),
)

MOVES = Table(
    "labware_move",
    "Every change of where labware is, or of what is known of that.",
    ("position",),
    (
        POSITION,
        AT,
        LABWARE,
        text("kind", "placed, moved, observed, uncertain or removed."),
        text("source", "Where it stood before, or the stack it came from; empty if nowhere."),
        text("target", "Where it stands since; empty if it is gone or that is not known."),
        text("lies_on", "The plate that it was laid on as a lid; empty if on none."),
        json("maybe", "Places where it may be; null if it is known where."),
        RUN,
        ACTION,
        text("actor", "Who caused it: a user, a module, or `labos`."),
        by_people("why", "A reason, or who saw it there; empty if there is none."),
    ),
    view="labware_moves",
    grows=True,
    indexes=(("labware", "position"),),
)

TOUCHES = Table(
    "labware_touch",
    "Which events concern which labware: one row for each of both.",
    ("labware", "position"),
    (LABWARE, POSITION),
    view="labware_touches",
    grows=True,
)

TRANSFERS = Table(
    "transfer",
    "Liquid that went into a well, came out of one, or was said to be in it: one row for each well.",
    ("position", "number"),
    (
        POSITION,
        whole("number", "Which well of the event, from 0."),
        AT,
        text("kind", "`in`, `out`, or `sheet` (a sheet of samples says what is there)."),
        LABWARE,
        text("well", "The well, as `B7`."),
        number("volume_ul", "How much, in µL; null if a sheet does not say."),
        text("liquid", "Of `in`: the reservoir or well it came from. Of `sheet`: the sample."),
        json("lots", "The lots it came from."),
        flag("certain", "Whether it is known that it took place."),
        MODULE,
        RUN,
        ACTION,
    ),
    view="transfers",
    grows=True,
    indexes=(("labware", "well", "position"), ("action",)),
)

SAMPLES = Table(
    "sample",
    "Which sample is in which well, as sheets said.",
    ("position", "well"),
    (
        whole("position", "Where the sheet stands in the log."),
        AT,
        LABWARE,
        text("well", "The well, as `B7`."),
        text("sample", "The sample."),
        number("volume_ul", "How much, in µL; null if nobody said."),
        text("sheet", "Digest of the sheet."),
        text("actor", "Who registered it."),
    ),
    view="samples",
    grows=True,
    indexes=(("sample",), ("labware", "position")),
)

RESOURCES = Table(
    "resource",
    "What is left of every consumable.",
    ("module", "resource"),
    (
        MODULE,
        text("resource", "Its name."),
        number("level", "How much is left, in the resource's unit."),
        number("capacity", "How much there is when it is full; null if nobody said."),
        json("lots", "What is left of each lot, oldest first: name, left, expires."),
        time("changed_at", "When that changed last."),
    ),
    view="resources",
)

RESOURCE_CHANGES = Table(
    "resource_change",
    "Every change of a consumable.",
    ("position",),
    (
        POSITION,
        AT,
        MODULE,
        text("resource", "Its name."),
        text("kind", "counted, replenished or consumed."),
        number("amount", "How much was counted, put in or used up."),
        number("level", "How much was left afterwards; null if nobody ever counted."),
        text("lot", "The lot; empty if nobody said."),
        text("expires", "Its last day, as `2027-05-31`; empty if nobody said."),
        RUN,
        ACTION,
        text("actor", "Who caused it: a user, a module, or `labos`."),
    ),
    view="resource_changes",
    grows=True,
    indexes=(("module", "resource", "position"), ("lot",), ("action",)),
)

LOT_USES = Table(
    "lot_use",
    "Every time a lot was put in, used up, or became labware or the content of wells.",
    ("position", "number"),
    (
        POSITION,
        whole("number", "Which lot of the event, from 0."),
        AT,
        text("lot", "The lot."),
        text("kind", "counted, replenished, loaded, consumed, labware or liquid."),
        MODULE,
        text("resource", "The consumable, liquid, or type of labware."),
        text("labware", "The labware that it became or went into; empty if none."),
        RUN,
        ACTION,
    ),
    view="lot_uses",
    grows=True,
    indexes=(("lot", "position"), ("labware",), ("action",)),
)

CALIBRATIONS = Table(
    "calibration",
    "Every calibration of a module that somebody recorded; the last one of the module and of `what` counts.",
    ("calibration",),
    (
        text("calibration", "Its name: the module, and where in the log it stands, as `rpl/hidex@41`."),
        POSITION,
        MODULE,
        text("what", "What of the module was calibrated; empty for all of it."),
        text("certificate", "The certificate's number; empty if nobody said."),
        text("recorded_by", "Who recorded it."),
        AT,
        text("until", "The last day on which it is valid, as `2027-01-01` (UTC); empty if nobody said."),
        number("ends_at_s", "When that day is over, in seconds since 1970 (UTC); null if nobody said."),
        text("file", "SHA-256 of the report, which is kept with the lab's files; empty if there is none."),
        by_people("why", "What they said about it."),
    ),
    view="calibrations",
    grows=True,
    indexes=(("module", "what", "position"),),
)

BENCH_TABLES = (
    *(LABWARE_TABLE, MOVES, TOUCHES, TRANSFERS, SAMPLES, RESOURCES, RESOURCE_CHANGES, LOT_USES),
    CALIBRATIONS,
)
