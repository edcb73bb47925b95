"""``labos``: the group of all commands, and the one place where errors are shown."""

from __future__ import annotations

import errno
import os
import sys
from importlib import import_module
from importlib.util import find_spec

import click

from labos.cli._exit import DONE, FAILED, IN_ONE_LINE, INTERRUPTED
from labos.cli._group import Suggesting
from labos.errors import LabosError, SystemFailed

SECTIONS = {
    "A lab": {
        "demo": "Run the demonstration: two users share a simulated workcell.",
        "up": "Run a lab in the foreground until Ctrl-C.",
        "api": "Serve the HTTP interface in a separate process.",
        "bus": "Run the bus in a separate process, for labs with a standby.",
        "take-over": "Let a standby take over while runs continue.",
        "pki": "Issue certificates for a secure bus.",
        "workcell": "Change a workcell while its lab runs.",
        "node": "Start the node of a module.",
        "driver": "Test a driver against faults, or create a new one.",
        "backup": "Copy the log and its blobs while the lab runs.",
        "restore": "Put a backup into an empty database.",
        "db": "Show the state of the database, or migrate it.",
        "doctor": "Check the lab's database, disk, network, nodes and backups.",
    },
    "Workflows": {
        "new": "Create a workcell, workflow or application from a template.",
        "validate": "Check a workflow before anything moves.",
        "plan": "Show the steps of a workflow, and how long they take.",
        "planner": "Search for a better order of steps, and suggest it to the lab.",
        "retarget": "Rewrite a workflow for another workcell.",
        "import": "Convert files of WEI and MADSci to the format of LabOS.",
        "schema": "Print the JSON Schema of a kind of file, for editors.",
        "actions": "List a module's actions with arguments, units and ranges.",
    },
    "Runs and experiments": {
        "run": "Run a workflow and wait for its end.",
        "submit": "Queue a workflow in the running lab.",
        "runs": "List runs and their progress, or the steps of one run.",
        "forecast": "Forecast when runs start and end, and when a person is needed.",
        "explain": "Explain why a run is waiting.",
        "cancel": "Cancel a run, an experiment, or all runs of a module or workcell.",
        "pause": "Pause a run, an experiment, a module, a workcell or the lab.",
        "resume": "Resume a paused run, experiment, module, workcell or lab.",
        "experiments": "List experiments.",
        "campaign": "Carry out a workflow for each row of a table.",
        "shares": "Show or set each user's share of the lab time.",
        "approvals": "List requests that wait for an approval, and why.",
        "approve": "Approve a request that waits for an approval.",
        "refuse": "Refuse a request that waits for an approval.",
        "policy": "Show or set which submissions need an approval.",
        "results": "Show what a run measured, well by well.",
        "files": "List or fetch files that steps have returned.",
    },
    "Modules": {
        "nodes": "List the nodes, their states and current actions.",
        "do": "Carry out one action of one module.",
        "reset": "Reset a module after an error.",
        "home": "Move a module to its home position.",
        "estop": "Stop modules at once, in an emergency.",
        "out-of-service": "Take a module out of service.",
        "in-service": "Put a module back in service.",
        "teach": "Set the pose at which an arm reaches a station.",
        "locations": "List the poses at which an arm reaches its stations.",
        "calibrate": "Record a calibration of a module.",
        "book": "Book a module or a workcell for a period of time.",
        "bookings": "List bookings.",
        "calendar": "Show the bookings of a week.",
    },
    "The bench": {
        "bench": "Declare the labware on the bench at the first start.",
        "stations": "Show the labware at each station, now or at a past moment.",
        "labware": "List labware, or show the history of one piece.",
        "samples": "Register or show the samples in the wells of a plate.",
        "barcode": "Record the barcode of a piece of labware.",
        "place": "Report that you put labware on a station.",
        "load": "Report that you loaded labware on a stack or a hotel.",
        "unload": "Report that you took labware away.",
        "observe": "Report what stands at a station.",
        "give": "Give labware to another user or experiment.",
        "inventory": "Show levels and lots of resources, and when they run out.",
        "replenish": "Report that you refilled a resource.",
    },
    "People": {
        "login": "Sign in to the lab.",
        "logout": "Sign out.",
        "whoami": "Show the name of the signed-in user, and your rights.",
        "token": "Manage access tokens for programs.",
        "user": "Manage users.",
        "group": "Manage groups of users, who share a part of the lab.",
        "role": "Manage roles: the rights of users and groups.",
        "mcp": "Let an agent read the lab, plan and propose work.",
        "interventions": "List questions of the lab to people, with possible answers.",
        "resolve": "Answer a question of the lab.",
        "inbox": "List planned work for people.",
        "confirm": "Confirm that planned work is done.",
        "access": "Reach into a workcell while its runs wait.",
        "notifications": "List sent and unsent notifications.",
        "handover-report": "Write a report for the next shift.",
    },
    "The log": {
        "find": "Find experiments, runs, samples, images and results by words.",
        "log": "Show what happened, event by event.",
        "replay": "Step through any log, with the state at each event.",
        "verify": "Check the log's chain of hashes.",
        "key": "Manage the keys that sign the lab's checkpoints.",
        "checkpoint": "Sign the present end of the log, and store it elsewhere.",
        "sign": "Sign the record of a run, an experiment or a campaign.",
        "erase": "Erase texts that people wrote: reasons, notes, comments.",
        "bundle": "Write a run, experiment or campaign to a file with its proof.",
        "witness": "Cosign other labs' checkpoints.",
        "sql": "Query the lab in SQL (read-only).",
        "provenance": "Trace labware, samples and results to their origin, or forward.",
        "export": "Export records in formats of other programs.",
        "diff": "Show the differences of the lab between two moments.",
        "audit": "Manage the tables that SQL queries read.",
        "twh": "Show the time without human intervention.",
    },
}

COMMANDS = {name: about for section in SECTIONS.values() for name, about in section.items()}

_ONE_FILE = {
    **dict.fromkeys(
        (
            "cancel",
            "pause",
            "resume",
            "resolve",
            "place",
            "barcode",
            "out-of-service",
            "in-service",
        ),
        "_person",
    ),
    **dict.fromkeys(("load", "unload", "replenish"), "stock"),
    **dict.fromkeys(("observe", "give"), "_bench"),
    **dict.fromkeys(("do", "reset", "home"), "do"),
    **dict.fromkeys(("inbox", "confirm"), "inbox"),
    **dict.fromkeys(("approvals", "approve", "refuse", "policy"), "approvals"),
    **dict.fromkeys(("teach", "locations"), "teach"),
    **dict.fromkeys(("bookings", "calendar"), "calendar"),
    **dict.fromkeys(("login", "logout", "whoami"), "login"),
}
"""Commands too small for a module of their own."""

_FILES = {**_ONE_FILE, "import": "import_", "handover-report": "handover_report", "take-over": "take_over"}
"""Modules whose names differ from the names of their commands."""


class Lazy(Suggesting):
    """Loads a command's module when the command is called, so that each starts fast and a faulty module
    affects no other command."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for name in COMMANDS if find_spec(_name_module(name)) is not None]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS or find_spec(_name_module(cmd_name)) is None:
            return None
        module = import_module(_name_module(cmd_name))
        found = getattr(module, cmd_name.replace("-", "_") if cmd_name in _ONE_FILE else "command")
        assert isinstance(found, click.Command)
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        known = set(self.list_commands(ctx))
        for title, section in SECTIONS.items():
            with formatter.section(title):
                width = max(map(len, COMMANDS))
                rows = [(name.ljust(width), about) for name, about in section.items() if name in known]
                formatter.write_dl(rows)


def _name_module(name: str) -> str:
    return f"labos.cli.{_FILES.get(name, name)}"


@click.group(
    cls=Lazy,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=f"Start with `labos demo`. Each command explains itself with --help.\n\n{IN_ONE_LINE}",
)
@click.version_option(package_name="labos-sdl", prog_name="labos")
def group() -> None:
    """LabOS runs a self-driving laboratory. It carries out workflows on instruments and logs every step.

    A lab has a folder (--home or LABOS_HOME; ./lab if neither is given) and a database (--database or
    LABOS_DATABASE_URL; a SQLite file in that folder if neither is given). To use a lab on another
    computer, set LABOS_URL to its address. docs/glossary.md explains the terms.
    """


def main(argv: list[str] | None = None) -> int:
    """Run the command line; returns the exit code, one of ``labos.cli._exit.CODES``. With ``--json``, an
    error is also JSON on standard output."""
    from labos.telemetry.logs import configure_logs

    configure_logs()
    try:
        code = group.main(argv, prog_name="labos", standalone_mode=False)
    except click.exceptions.Exit as done:
        code = done.exit_code
    except click.Abort:
        code = INTERRUPTED
    except click.ClickException as error:
        if "--json" in (sys.argv[1:] if argv is None else argv):
            _show_misuse(error)
        error.show()
        code = error.exit_code
    except KeyboardInterrupt:
        code = INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has ended, as `head` does.
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        code = DONE
    except (OSError, LabosError) as error:
        if os.environ.get("LABOS_DEBUG") == "1":
            raise
        known = error if isinstance(error, LabosError) else _describe_system_error(error)
        if "--json" in (sys.argv[1:] if argv is None else argv):
            _show_error(known)
        click.echo(f"labos: {known}", err=True)
        code = FAILED
    return code if isinstance(code, int) else DONE


def _show_error(error: LabosError) -> None:
    """``{error, remedy, code, details}``; the codes are those of HTTP."""
    from labos.cli._out import show_json
    from labos.http.problems import describe_error

    show_json(describe_error(error))


def _show_misuse(error: click.ClickException) -> None:
    from labos.cli._out import show_json

    remedy = "See --help of the command."
    show_json({"error": error.format_message(), "remedy": remedy, "code": "misused", "details": []})


def _describe_system_error(error: OSError) -> SystemFailed:
    """An error of a file, a folder or the network, as one of our own errors."""
    what = f"{error.filename}: " if error.filename else ""
    reason = error.strerror or str(error) or type(error).__name__
    remedy = {
        errno.ENOSPC: "Free some space on its disk, then try again.",
        errno.EROFS: "Name a folder with write permission, or mount its disk for writing.",
        errno.EACCES: "Give the user that runs LabOS read and write permission, or name another one.",
        errno.EPERM: "Give the user that runs LabOS read and write permission, or name another one.",
    }.get(error.errno or 0, "LABOS_DEBUG=1 shows where it happened.")
    return SystemFailed(f"{what}{reason}.", remedy=remedy)
