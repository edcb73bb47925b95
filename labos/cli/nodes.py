"""``labos nodes``: lists modules and their nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._exit import DONE, FAILED
from labos.cli._lab import need_lab_of
from labos.cli._liveness import open_current_log
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_and_json
from labos.core.ids import local
from labos.errors import NotFound
from labos.services.history import fold_state_at
from labos.settings import find_kernel, last_kernel

REMEDIES = {
    "ERROR": "Solve the reported problem, then run: labos reset {module}",
    "silent": "Start it: labos node start, or labos up on its computer.",
    "frozen": "End its process. LabOS starts it again.",
    "out": "When it works again: labos in-service {module}",
}
"""The remedies for a module that does not work, by the answer of its node."""


@click.command("nodes")
@click.argument("modules", nargs=-1, metavar="[MODULE]...", shell_complete=make_completer("module"))
@click.option(
    "--check",
    is_flag=True,
    help="Ask each node and its device for their identity and observations.",
)
@log_and_json
def command(where: Where, modules: tuple[str, ...], check: bool) -> None:
    """List the lab's modules, their states and current actions. If no kernel runs, the command shows the last
    known states.

    \b
    labos nodes
    labos nodes --json
    labos nodes --check           ask every node and device now; exit code 1 if one is unavailable
    labos nodes --check pf400

    A check moves nothing. It reports the driver, its version of LabOS, the unit (serial number) to which
    the module is bound, the device's firmware, and its observations. If a module cannot work, the check
    reports a remedy.
    """
    if check or modules:
        _check(where, modules)
        return
    if not where.lab and find_kernel(where.home) is None:
        was_here = (where.home / "labos.db").exists() or last_kernel(where.home) is not None
        if not where.database and not was_here:
            raise NotFound(f"No lab runs in {where.home}.", remedy="Start one with `labos up`.")
        known = _list_last_known(where)
    else:
        with need_lab_of(where) as client:
            known = [_drop_old_name(one) for one in client.state(waits=False)["modules"]]
    end_with_json(known)
    columns = ("module", "driver", "status", "doing", "pid", "problem", "calibrated until")
    show_table(columns, list(map(_row, known)), optional="calibrated until")


def _check(where: Where, names: Sequence[str]) -> None:
    with need_lab_of(where) as client:
        found = [_drop_old_name(one) for one in client.check_nodes(names)]
    unable = [one for one in found if one["answer"] not in ("IDLE", "BUSY")]
    end_with_json(found, FAILED if unable else DONE)
    columns = ("module", "answers", "driver", "labos", "unit", "firmware", "sees")
    show_table(columns, [_list_columns(one) for one in found])
    for one in unable:
        remedy = REMEDIES.get(one["answer"], "").format(module=local(one["module"]))
        click.echo(f"{local(one['module'])}: {one['why'].rstrip('.')}. {remedy}".rstrip())
    if unable:
        click.get_current_context().exit(FAILED)


def _drop_old_name(one: dict[str, Any]) -> dict[str, Any]:
    """A module in the API's answer, without the field that `module` has replaced."""
    return {key: value for key, value in one.items() if key != "name"}


def _list_columns(one: dict[str, Any]) -> tuple[str, ...]:
    checked = one["checked"]
    if checked is None:
        return (one["module"], one["answer"], "", "", "", "", "")
    driver = f"{checked['driver']} {checked['version']}{' (simulated)' if checked['simulated'] else ''}"
    sees = ", ".join(f"{name} {value}" for name, value in _flatten_seen(checked["sees"]))
    seen = checked["sees_nothing"] or sees or "nothing"
    device = (checked["unit"], checked["firmware"])
    return (one["module"], one["answer"], driver, checked["labos"], *device, seen)


def _flatten_seen(seen: dict[str, Any]) -> list[tuple[str, Any]]:
    """The observations, by place or variable."""
    labware = seen.get("labware") or {}
    places = [(place, {True: "full", False: "empty"}.get(what, what)) for place, what in labware.items()]
    return [*places, *((name, value) for name, value in seen.items() if name != "labware")]


def _list_last_known(where: Where) -> list[dict[str, Any]]:
    """The modules according to the log. Raises NotFound if there is none."""
    from labos.http.views import list_calibrations

    with open_current_log(where) as store:
        state = fold_state_at(store)
    doing = state.actions.open
    return [
        {
            "module": name,
            "driver": module.driver or module.spec.driver,
            "simulated": module.simulated,
            "status": "not known",
            "doing": [
                {"action": doing[action].name, "run": doing[action].run, "status": doing[action].status}
                for action in module.in_flight
                if action in doing
            ],
            "out_of_service": module.out_of_service,
            "problem": module.out_of_service or module.error,
            "process": None,
            "calibrations": msgspec.to_builtins(list_calibrations(module)),
        }
        for name, module in state.modules.by_name.items()
    ]


def _find_valid_until(module: dict[str, Any]) -> str:
    """The last day of the calibration that expires first; empty if none does."""
    return min((one["until"] for one in module.get("calibrations", ()) if one["until"]), default="")


def _describe_action(action: dict[str, Any]) -> str:
    ended = " (outcome unknown)" if action["status"] == "unknown" else ""
    return f"{action['action']} for {action['run']}{ended}"


def _row(module: dict[str, Any]) -> tuple[str, ...]:
    process = module["process"] or {}
    doing = ", ".join(map(_describe_action, module["doing"]))
    is_well = module["status"] in ("IDLE", "BUSY") and not module["out_of_service"]
    problem = "" if is_well else module["problem"]
    driver = f"{module['driver']}{' (simulated)' if module['simulated'] else ''}"
    pid, until = str(process.get("pid") or ""), _find_valid_until(module)
    return (module["module"], driver, module["status"], doing, pid, problem, until)
