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
    flag,
    json,
    make_words_column,
    number,
    text,
    time,
    whole,
)

LABWARE_TABLE = Table(
    "labware",
    "Every piece of labware that ever got an id, in its present state or as it was when it left the bench.",
    ("labware",),
    (
        LABWARE,
        text("type", "Its type."),
        text(
            "station",
            "The station at which it stands; empty if it is gone, lies on a plate, or its place is unknown.",
        ),
        text("lies_on", "The plate on which it lies as a lid; empty if none."),
        text("lid", "The lid that lies on it; empty if none."),
        json("maybe", "The places where it may be if its place is not known; null if it is known."),
        text("owner", "`run:…`, `experiment:…`, `user:…`, `shared`, or empty for nobody."),
        text("barcode", "Its barcode; empty if not known."),
        text("lot", "The lot from which it came; empty if not given."),
        json("variables", "Its variables, such as `sealed`."),
        json("samples", "The samples by well, from its last sheet."),
        time("placed_at", "The time at which it got its id."),
        time("gone_at", "The time at which it left the bench; null if it has not left."),
        text("gone", "The reason why it left; empty if it has not left."),
        whole("placed_position", "The position in the log at which it got its id."),
        whole("gone_position", "The position in the log at which it left; null if it has not left."),
    ),
    view="labware",
    indexes=(("lot",), ("barcode",)),
)

MOVES = Table(
    "labware_move",
    "Every change of the place of labware, or of the knowledge about it.",
    ("position",),
    (
        POSITION,
        AT,
        LABWARE,
        text("kind", "placed, moved, observed, uncertain or removed."),
        text("source", "The station where it stood before, or the stack from which it came; empty if none."),
        text(
            "target", "The station where it stands afterwards; empty if it is gone or its place is not known."
        ),
        text("lies_on", "The plate on which it was put as a lid; empty if none."),
        json("maybe", "The places where it may be; null if its place is known."),
        RUN,
        ACTION,
        text("actor", "The cause: a user, a module, or `labos`."),
        make_words_column("why", "A reason, or the observer; empty if none."),
    ),
    view="labware_moves",
    indexes=(("labware", "position"),),
)

TOUCHES = Table(
    "labware_touch",
    "The events that concern each piece of labware: one row for each pair.",
    ("labware", "position"),
    (LABWARE, POSITION),
    view="labware_touches",
)

TRANSFERS = Table(
    "transfer",
    "Liquid that went into a well, left a well, or was declared in a sample sheet: one row for each well.",
    ("position", "number"),
    (
        POSITION,
        whole("number", "The number of the well in the event, from 0."),
        AT,
        text("kind", "`in`, `out`, or `sheet` (declared in a sample sheet)."),
        LABWARE,
        text("well", "The well, such as `B7`."),
        number("volume_ul", "The volume in µL; null if a sheet does not give it."),
        text("liquid", "For `in`: the reservoir or well from which it came. For `sheet`: the sample."),
        json("lots", "The lots from which it came."),
        flag("certain", "True if it certainly took place."),
        MODULE,
        RUN,
        ACTION,
    ),
    view="transfers",
    indexes=(("labware", "well", "position"), ("action",)),
)

SAMPLES = Table(
    "sample",
    "The sample in each well, from sample sheets.",
    ("position", "well"),
    (
        whole("position", "The position of the sheet in the log."),
        AT,
        LABWARE,
        text("well", "The well, such as `B7`."),
        text("sample", "The sample."),
        number("volume_ul", "The volume in µL; null if not given."),
        text("sheet", "The digest of the sheet."),
        text("actor", "The user who registered it."),
    ),
    view="samples",
    indexes=(("sample",), ("labware", "position")),
)

RESOURCES = Table(
    "resource",
    "The remaining amount of every consumable.",
    ("module", "resource"),
    (
        MODULE,
        text("resource", "Its name."),
        number("level", "The remaining amount, in the unit of the resource."),
        number("capacity", "The amount when it is full; null if not given."),
        json("lots", "The rest of each lot, the oldest first: name, left, expires."),
        time("changed_at", "The time of the last change."),
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
        number("amount", "The amount that was counted, put in or used up."),
        number("level", "The remaining amount afterwards; null if it was never counted."),
        text("lot", "The lot; empty if not given."),
        text("expires", "The expiry date, such as `2027-05-31`; empty if not given."),
        RUN,
        ACTION,
        text("actor", "The cause: a user, a module, or `labos`."),
    ),
    view="resource_changes",
    indexes=(("module", "resource", "position"), ("lot",), ("action",)),
)

LOT_USES = Table(
    "lot_use",
    "Every use of a lot: put in, used up, or the source of labware or of a well's content.",
    ("position", "number"),
    (
        POSITION,
        whole("number", "The number of the lot in the event, from 0."),
        AT,
        text("lot", "The lot."),
        text("kind", "counted, replenished, loaded, consumed, labware or liquid."),
        MODULE,
        text("resource", "The consumable, liquid, or type of labware."),
        text("labware", "The labware that came from the lot, or into which it went; empty if none."),
        RUN,
        ACTION,
    ),
    view="lot_uses",
    indexes=(("lot", "position"), ("labware",), ("action",)),
)

CALIBRATIONS = Table(
    "calibration",
    "Every recorded calibration of a module. The last one for a module and a `what` is valid.",
    ("calibration",),
    (
        text("calibration", "Its name: the module and the position in the log, such as `rpl/hidex@41`."),
        POSITION,
        MODULE,
        text("what", "The calibrated part or quantity of the module; empty for the whole module."),
        text("certificate", "The certificate's number; empty if not given."),
        text("recorded_by", "The user who recorded it."),
        AT,
        text("until", "The last day on which it is valid, such as `2027-01-01` (UTC); empty if not given."),
        number("ends_at_s", "When that day is over, in seconds since 1970 (UTC); null if not given."),
        text(
            "file", "The SHA-256 of the report, which is stored with the lab's files; empty if there is none."
        ),
        make_words_column("why", "Their comment."),
    ),
    view="calibrations",
    indexes=(("module", "what", "position"),),
)

BENCH_TABLES = (
    *(LABWARE_TABLE, MOVES, TOUCHES, TRANSFERS, SAMPLES, RESOURCES, RESOURCE_CHANGES, LOT_USES),
    CALIBRATIONS,
)
