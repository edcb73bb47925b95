"""The actions of a run in its crate: driver, labware, lots, arguments, files, results."""

from __future__ import annotations

import mimetypes
from typing import Any

import msgspec

from labos.audit._crate_parts import Crate, make_link, make_local_id, safe_name, with_offset
from labos.audit.query import ReadConnection
from labos.core.canonical import encode_canonical
from labos.core.ids import local

STATUS = {
    "completed": "Completed",
    "succeeded": "Completed",
    "failed": "Failed",
    "cancelled": "Failed",
    "unknown": "Failed",
}
"""The terms of schema.org for the end of a run or an action; without an end it is active."""


class Doer(msgspec.Struct, frozen=True):
    """The owner of the actions: the run, the digest of its plan, and the ids of its user and its workflow."""

    run: str
    plan: str
    user: str
    workflow: str


class RecordedAction(msgspec.Struct, frozen=True):
    """Ids of an action, of the control action of its step, of the things that it used, and of the files that
    it made."""

    id: str
    control: str
    used: list[str]
    made: list[str]


class _Action(msgspec.Struct, frozen=True):
    """A row of the view ``actions``."""

    step: int | None
    key: str
    module: str
    name: str
    driver: str
    driver_version: str
    about: str
    simulated: Any
    args: Any
    labware: Any
    status: str
    error: str
    result: Any
    requested_at: str
    ended_at: str | None


def json_of(value: Any) -> Any:
    """The value of a JSON column of a view, which is text; an empty object for none."""
    return msgspec.json.decode(value) if value else {}


def add_action(crate: Crate, asker: ReadConnection, doer: Doer, action: str) -> RecordedAction:
    """Add an action of a module, with everything that belongs to it."""
    columns = ", ".join(_Action.__struct_fields__)
    found = _Action(*asker.fetch(f"SELECT {columns} FROM actions WHERE action = ?", action)[0])
    id_ = make_local_id("action", action)
    tool = _add_driver(crate, found)
    used = [
        *_add_labware(crate, asker, json_of(found.labware) or []),
        *_add_lots(crate, asker, action),
        *_add_files(crate, asker, action, "given"),
    ]
    made = _add_files(crate, asker, action, "returned")
    result = json_of(found.result) if found.result is not None else None
    if result:
        path = f"runs/{doer.run}/results/{found.step}-{safe_name(found.key)}.json"
        words = f"Result of step {found.step} ({found.key}) of {doer.run}"
        made.append(crate.put(path, encode_canonical(result), name=words, encodingFormat="application/json"))
    arguments = [
        crate.add(
            "PropertyValue",
            make_local_id("argument", f"{action} {name}"),
            name=name,
            value=_make_value(value),
        )
        for name, value in json_of(found.args).items()
    ]
    status = STATUS.get(found.status, "Active")
    module = local(found.module)
    crate.add(
        "CreateAction",
        id_,
        name=f"{doer.run} #{found.step}: {found.key or found.name}",
        description=f"{module} carries out {found.name}; it is {found.status}.",
        instrument=make_link(tool),
        agent=make_link(doer.user),
        startTime=with_offset(found.requested_at),
        endTime=with_offset(found.ended_at),
        actionStatus=f"http://schema.org/{status}ActionStatus",
        error=(found.error or found.status) if status == "Failed" else None,
        object=make_link(*arguments, *used),
        result=make_link(*made),
    )
    return RecordedAction(id_, _add_step(crate, doer, found, id_, tool), used, made)


def _add_step(crate: Crate, doer: Doer, found: _Action, action: str, tool: str) -> str:
    """Add the step of the workflow, its tool, and the control action that links this action to it; returns
    the id of the last."""
    step = crate.add(
        "HowToStep",
        f"{doer.workflow}#{doer.plan[:12]}-{found.step}",
        name=found.key or found.name,
        position=str(0 if found.step is None else found.step + 1),
    )
    crate.extend(step, "workExample", tool)
    crate.extend(doer.workflow, "step", step)
    crate.extend(doer.workflow, "hasPart", tool)
    return crate.add(
        "ControlAction",
        action.replace("#action-", "#control-", 1),
        name=f"Step {found.step} of {doer.run}",
        instrument=make_link(step),
        object=make_link(action),
    )


def _add_driver(crate: Crate, found: _Action) -> str:
    """Add the driver as the tool, and its module, with the description of that time."""
    short = local(found.module)
    words = f"The module {short} of the lab."
    if found.about:
        words += f" The SHA-256 of its node's description (actions, arguments, units) was {found.about}."
    module = crate.add(
        "IndividualProduct",
        make_local_id("module", f"{found.module} {found.about[:12]}".strip()),
        name=found.module,
        description=words,
    )
    name, version = found.driver or "unknown", found.driver_version
    simulated = ", simulated" if found.simulated else ""
    driver = crate.add(
        "SoftwareApplication",
        make_local_id("driver", f"{found.module} {name} {version}{simulated}"),
        name=f"Driver {name} of {short}{simulated}",
        softwareVersion=version,
    )
    crate.extend(driver, "about", module)
    return driver


def _add_labware(crate: Crate, asker: ReadConnection, names: list[str]) -> list[str]:
    ids = []
    for name in names:
        rows = asker.fetch("SELECT type, barcode, lot FROM labware WHERE labware = ?", name)
        kind, barcode, lot = rows[0] if rows else ("", "", "")
        ids.append(
            crate.add(
                "IndividualProduct",
                make_local_id("labware", name),
                name=f"{kind} {name}".strip(),
                category=kind,
                identifier=[name, barcode] if barcode else name,
                isRelatedTo=make_link(_add_lot(crate, lot, "")) if lot else None,
            )
        )
    return ids


def _add_lots(crate: Crate, asker: ReadConnection, action: str) -> list[str]:
    rows = asker.fetch(
        "SELECT DISTINCT lot, resource FROM lot_uses WHERE action = ? AND kind <> 'labware' ORDER BY lot",
        action,
    )
    return [_add_lot(crate, lot, resource) for lot, resource in rows]


def _add_lot(crate: Crate, lot: str, resource: str) -> str:
    return crate.add(
        "Product", make_local_id("lot", lot), name=f"Lot {lot}", productID=lot, category=resource or None
    )


def _add_files(crate: Crate, asker: ReadConnection, action: str, kind: str) -> list[str]:
    """Add the input and result files of an action."""
    rows = asker.fetch(
        "SELECT digest, file, bytes FROM files WHERE action = ? AND kind = ? ORDER BY position, number",
        action,
        kind,
    )
    return [
        crate.put_blob(
            f"files/{safe_name(file)}",
            digest,
            size,
            name=file,
            encodingFormat=mimetypes.guess_type(file)[0] or "application/octet-stream",
        )
        for digest, file, size in rows
    ]


def _make_value(value: Any) -> str | int | float | bool:
    return value if isinstance(value, str | int | float | bool) else encode_canonical(value).decode()
