"""``labos nodes``: which nodes live."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._options import json_option
from labos.cli._query import Where, kernel_file, log_options, reading
from labos.errors import NotFound


@click.command("nodes")
@json_option
@log_options
def command(where: Where, as_json: bool) -> None:
    """Which modules the lab has, how they are, and what they do. Where no kernel runs, nobody knows how they
    are: what was known last is shown.

    \b
    labos nodes
    labos nodes --json
    """
    from labos.cli._out import show_json, show_table
    from labos.client import LabClient
    from labos.settings import find_kernel

    kernel = find_kernel(where.home)
    if kernel is None:
        if not where.database and not (where.home / "labos.db").exists() and not kernel_file(where.home):
            raise NotFound(f"No lab runs in {where.home}.", remedy="Start one with `labos up`.")
        modules = _last_known(where)
    else:
        with LabClient(kernel.url) as client:
            modules = client.state(waits=False)["modules"]
    if as_json:
        show_json(modules)
        return
    show_table(
        ("module", "driver", "status", "doing", "pid", "problem"), [_row(module) for module in modules]
    )


def _last_known(where: Where) -> list[dict[str, Any]]:
    """The modules as the log knows them. Raises NotFound if there is none."""
    from labos.cli._living import say_if_dead
    from labos.services.history import state_at

    with reading(where) as store:
        say_if_dead(where.url, store.head())
        state = state_at(store)
    doing = state.actions.open
    return [
        {
            "name": name,
            "driver": module.driver or module.spec.driver,
            "simulated": module.simulated,
            "status": "not known",
            "doing": [
                {"action": doing[action].name, "run": doing[action].run}
                for action in module.in_flight
                if action in doing
            ],
            "out_of_service": module.out_of_service,
            "problem": module.out_of_service or module.error,
            "process": None,
        }
        for name, module in state.modules.by_name.items()
    ]


def _row(module: dict[str, Any]) -> tuple[str, ...]:
    process = module["process"] or {}
    doing = ", ".join(f"{action['action']} for {action['run']}" for action in module["doing"])
    is_well = module["status"] in ("IDLE", "BUSY") and not module["out_of_service"]
    problem = "" if is_well else module["problem"]
    driver = f"{module['driver']}{' (simulated)' if module['simulated'] else ''}"
    return (module["name"], driver, module["status"], doing, str(process.get("pid") or ""), problem)
