"""``labos driver``: for who writes drivers."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from labos.cli._options import json_option
from labos.cli._out import show_json
from labos.errors import BadInput

if TYPE_CHECKING:
    from labos.torture import Report

MARKS = {"passed": "ok", "failed": "FAILED", "left out": "left out"}


@click.group("driver")
def command() -> None:
    """Torture a driver, or begin a new one."""


@command.command("torture")
@click.argument("driver")
@click.option("--check", "only", multiple=True, metavar="NAME", help="Only this check.")
@click.option(
    "--at-least",
    type=click.Choice(["bronze", "silver", "gold"]),
    default="bronze",
    show_default=True,
    help="Exit with 1 if the badge is below this.",
)
@click.option(
    "--motion-s",
    type=click.FloatRange(min=0.2),
    default=1.0,
    help="Seconds that the longest motion takes.",
)
@click.option("--keep", metavar="DIR", help="Keep journals, logs and the bench in this new folder.")
@json_option
def torture_command(
    driver: str, only: tuple[str, ...], at_least: str, motion_s: float, keep: str | None, as_json: bool
) -> None:
    """Put DRIVER through everything that can go wrong, and print its badge and the evidence for it.

    DRIVER is an installed one, or a file: shaker.py, shaker.py:Shaker. What the suite has to know beside
    the driver's description stands in its TORTURE. Bronze speaks, silver survives, gold reconciles an
    unknown outcome by observing.

    \b
    labos driver torture a4s_sealer
    labos driver torture ./shaker.py --at-least silver
    labos driver torture liconic --check "late reply" --keep torment
    """
    from labos.torture import RANKS, Finding, torture

    folder = Path(keep) if keep else None
    if folder is not None and folder.exists():
        raise BadInput(f"{folder} is there already.", remedy="Name a new folder.")

    def tell(finding: Finding) -> None:
        if not (as_json or (only and finding.verdict == "left out")):
            why = f": {finding.why}" if finding.why else ""
            took = f" ({finding.seconds:.1f} s)" if finding.verdict != "left out" else ""
            click.echo(f"{finding.tier:6}  {finding.check:18}  {MARKS[finding.verdict]}{took}{why}")

    report = asyncio.run(torture(driver, tell=tell, only=only, motion_s=motion_s, folder=folder))
    if as_json:
        show_json(report)
    else:
        _show(report)
    enough = not report.failed if only else RANKS.index(report.badge) >= RANKS.index(at_least)
    if not enough:
        raise click.exceptions.Exit(1)


def _show(report: Report) -> None:
    from labos.torture import MEANING

    click.echo(f"{report.driver} {report.version}: {report.badge} ({MEANING[report.badge]})")
    for line in report.evidence:
        click.echo(f"  evidence: {line}")
    if report.limits:
        click.echo(f"  no higher badge, because {report.limits}")
