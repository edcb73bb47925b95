"""``labos nodes``: which nodes live."""

from __future__ import annotations

from typing import Any

import click

from labos.cli._options import home_option, json_option


@click.command("nodes")
@home_option
@json_option
def command(home: str | None, as_json: bool) -> None:
    """Which modules the lab has, how they are, and what they do. Where no kernel runs: how they last were.

    \b
    labos nodes
    labos nodes --json
    """
    from labos.cli._living import modules_and_questions
    from labos.cli._out import show_json, show_table

    modules = modules_and_questions(home)["modules"]
    if as_json:
        show_json(modules)
        return
    show_table(
        ("module", "driver", "status", "doing", "pid", "problem"), [_row(module) for module in modules]
    )


def _row(module: dict[str, Any]) -> tuple[str, ...]:
    process = module["process"] or {}
    doing = ", ".join(f"{action['action']} for {action['run']}" for action in module["doing"])
    problem = module["problem"] if module["status"] in ("GONE", "ERROR") or module["out_of_service"] else ""
    driver = f"{module['driver']}{' (simulated)' if module['simulated'] else ''}"
    return (module["name"], driver, module["status"], doing, str(process.get("pid") or ""), problem)
