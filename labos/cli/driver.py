"""``labos driver``: tools for authors of drivers."""

from __future__ import annotations

import asyncio
import shlex
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING

import click

from labos.cli._complete import make_completer
from labos.cli._describe import describe_command
from labos.cli._group import Suggesting
from labos.cli._options import json_option
from labos.cli._out import end_with_json, show_lines, wants_json
from labos.errors import BadInput

if TYPE_CHECKING:
    from labos.torture import Report

SKELETON = Path(__file__).with_name("skeletons") / "driver"
MARKS = {"passed": "ok", "failed": "FAILED", "left out": "left out"}


@click.group("driver", cls=Suggesting)
def command() -> None:
    """Test a driver against faults, describe its instrument, or create a new driver."""


command.add_command(describe_command)


@command.command("torture")
@click.argument("driver", shell_complete=make_completer("driver"))
@click.option("--check", "only", multiple=True, metavar="NAME", help="Run only this check.")
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
    help="The duration of the longest motion, in seconds.",
)
@click.option("--keep", metavar="DIR", help="Keep journals, logs and the bench in this new folder.")
@json_option
def torture_command(
    driver: str, only: tuple[str, ...], at_least: str, motion_s: float, keep: str | None
) -> None:
    """Test DRIVER against faults of every kind, and print its badge with the evidence.

    DRIVER is an installed driver or a file: shaker.py, shaker.py:Shaker. The driver's TORTURE holds
    further settings for the test suite. Bronze: the driver follows the protocol. Silver: it survives
    faults. Gold: it also finds out by observation how an interrupted action ended.

    \b
    labos driver torture a4s_sealer
    labos driver torture ./shaker.py --at-least silver
    labos driver torture liconic --check "late reply" --keep evidence
    """
    from labos.torture import RANKS, Finding, torture

    folder = Path(keep) if keep else None
    if folder is not None and folder.exists():
        raise BadInput(f"{folder} already exists.", remedy="Name a new folder.")

    def show(finding: Finding) -> None:
        if not (wants_json() or (only and finding.verdict == "left out")):
            why = f": {finding.why}" if finding.why else ""
            took = f" ({finding.seconds:.1f} s)" if finding.verdict != "left out" else ""
            click.echo(f"{finding.tier:6}  {finding.check:18}  {MARKS[finding.verdict]}{took}{why}")

    report = asyncio.run(torture(driver, show=show, only=only, motion_s=motion_s, folder=folder))
    enough = not report.failed if only else RANKS.index(report.badge) >= RANKS.index(at_least)
    end_with_json(report, int(not enough))
    _show(report)
    if not enough:
        raise click.exceptions.Exit(1)


def _show(report: Report) -> None:
    from labos.torture import MEANING

    click.echo(f"{report.driver} {report.version}: {report.badge} ({MEANING[report.badge]})")
    show_lines(report.evidence, "  evidence: ")
    if report.limits:
        click.echo(f"  no higher badge, because {report.limits}")


@command.command("new")
@click.argument("name")
@json_option
def new_command(name: str) -> None:
    """Create the package of a driver NAME in a new folder of that name.

    The package works without changes: an interface, a driver, a simulated device on a real serial line,
    and a test against faults (`labos driver torture`). NAME may be a path to another folder.

    \b
    labos driver new shaker
    pip install -e "./shaker[test]"
    labos driver torture shaker
    """
    folder = Path(name)
    package = folder.name.replace("-", "_")
    if not package.isidentifier() or package != package.lower() or iskeyword(package):
        raise BadInput(
            f"{folder.name!r} cannot be the name of a driver.",
            remedy="Use small letters, digits and '_', beginning with a letter.",
        )
    if folder.exists():
        raise BadInput(f"{folder} already exists.", remedy="Use another name.")
    _refuse_if_taken(package)
    files = _make_skeleton(folder, package)
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    end_with_json({"written": [str(path) for path in files]})
    show_lines(files, "wrote ")
    click.echo("Next:")
    click.echo(f"  pip install -e {shlex.quote(f'{folder.absolute()}[test]')}")
    click.echo(f"  labos driver torture {package}")


def _refuse_if_taken(name: str) -> None:
    """Two drivers with the same name could not be used. Raises BadInput."""
    from labos.bootstrap import list_installed, source_of

    if entries := list_installed().get(name):
        raise BadInput(
            f"A driver {name!r} is already installed, by {source_of(entries[0])}.",
            remedy="Use another name. To replace that driver, uninstall its package first.",
        )


def _make_skeleton(folder: Path, name: str) -> dict[Path, str]:
    """The files to write. The package does not have the plain name, which may be taken."""
    words = {
        "PACKAGE": f"labos_{name}",
        "DASHED": name.replace("_", "-"),
        "CLASS": "".join(part.capitalize() for part in name.split("_")),
        "NAME": name,
    }

    def fill(text: str) -> str:
        for word, value in words.items():
            text = text.replace(word, value)
        return text

    return {
        folder / _rename(path, words): fill(path.read_text(encoding="utf-8"))
        for path in sorted(SKELETON.rglob("*"))
        if path.suffix in (".py", ".md", ".toml", ".yaml")
    }


def _rename(path: Path, words: dict[str, str]) -> str:
    parts = path.relative_to(SKELETON).parts
    return "/".join(
        words["PACKAGE"] if part == "package" else part.replace("NAME", words["NAME"]) for part in parts
    )
