"""``labos``: the group of all commands, and the one place where errors become words."""

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
        "api": "Serve the HTTP interface in a process of its own.",
        "bus": "Run the bus by itself, for kernels that take over from each other.",
        "take-over": "Let a standby take over while runs go on.",
        "pki": "Certificates for a secure bus.",
        "workcell": "Change a workcell while its lab runs.",
        "node": "Start the node of a module.",
        "driver": "Torture a driver, or begin a new one.",
        "backup": "Copy the log and its blobs while the lab runs.",
        "restore": "Put a backup into an empty database.",
        "db": "The database: its state, and migrating it.",
        "doctor": "Is everything that a lab stands on as it should be?",
    },
    "Workflows": {
        "new": "A workcell, workflow or application to begin with.",
        "validate": "Check a workflow before anything moves.",
        "plan": "The steps of a workflow, and how long they take.",
        "planner": "Suggest in which order to start what is to be done.",
        "retarget": "Rewrite a workflow for another workcell.",
        "import": "Rewrite files of WEI and MADSci in LabOS' own form.",
        "schema": "The JSON Schema of a file, for editors.",
        "actions": "What a module can do: actions, arguments, units and ranges.",
    },
    "Runs and experiments": {
        "run": "Run a workflow and wait for its end.",
        "submit": "Queue a workflow in the running lab.",
        "runs": "Which runs there are and how far they are.",
        "forecast": "When runs start and end, and when a person is needed.",
        "explain": "Why a run does not go on.",
        "cancel": "Cancel a run, an experiment, or what runs somewhere.",
        "pause": "Start nothing more of a run, an experiment, a module, a workcell.",
        "resume": "Let what is paused go on.",
        "experiments": "Which experiments there are.",
        "campaign": "Carry out a workflow for each row of a table.",
        "shares": "Who is to have how much of the lab, and who has had it.",
        "approvals": "What waits for an approval, and why.",
        "approve": "Let what waits for an approval go on.",
        "refuse": "Do not let it go on.",
        "policy": "Which submissions wait for an approval.",
        "results": "What a run measured, well by well.",
        "files": "Files that steps have returned, to list and to fetch.",
    },
    "Modules": {
        "nodes": "Which nodes live, and what they do.",
        "do": "Carry out one action of one module.",
        "reset": "Bring a module out of its error.",
        "home": "Bring a module to its home position.",
        "estop": "Stop modules at once, in an emergency.",
        "out-of-service": "Take a module out of service.",
        "in-service": "Put a module back in service.",
        "teach": "Say where an arm finds a station.",
        "locations": "Where an arm finds its stations, and since which version.",
        "calibrate": "Record a calibration of a module.",
        "book": "Book a module or a workcell for a while.",
        "bookings": "Which bookings there are.",
        "calendar": "When what is booked.",
    },
    "The bench": {
        "bench": "Say what stands on the bench at the first start.",
        "stations": "What stands where, now or at any past moment.",
        "labware": "Every piece of labware and its story.",
        "samples": "Which samples are in which wells.",
        "barcode": "Say which barcode labware bears.",
        "place": "Say that labware was put on a station.",
        "load": "Say that labware was loaded, with its lot.",
        "unload": "Say that labware was taken away.",
        "observe": "Say what stands at a station.",
        "give": "Hand labware over to somebody else.",
        "inventory": "What is left, of which lots, and what runs out when.",
        "replenish": "Say that a resource was refilled, with its lot.",
    },
    "People": {
        "login": "Sign in to the lab.",
        "logout": "Sign out.",
        "whoami": "Who you are to the lab.",
        "token": "Tokens of programs.",
        "user": "Users: who may use the lab.",
        "group": "Groups: users who share a part of the lab.",
        "role": "Roles: what users and groups may do.",
        "mcp": "Let an agent look, plan and propose.",
        "interventions": "What the lab asks people, and what they may answer.",
        "resolve": "Answer a question that the lab asks a person.",
        "inbox": "The work that workflows plan for people.",
        "confirm": "Say that planned work is done.",
        "access": "Reach into a workcell: everything there waits meanwhile.",
        "notifications": "Who was told of what, and what is still to be told.",
        "handover-report": "What the next shift has to know.",
    },
    "The log": {
        "find": "Find experiments, runs, samples, images and results by words.",
        "log": "What happened, event by event.",
        "replay": "Step through any log, with the state at each event.",
        "verify": "Check the log's chain of hashes.",
        "key": "The keys that sign a lab's checkpoints.",
        "checkpoint": "Sign the log's end, and keep it elsewhere.",
        "sign": "Sign the record of a run, an experiment or a campaign.",
        "erase": "Erase what people wrote: reasons, notes, comments.",
        "bundle": "A run, an experiment or a campaign as a file that proves itself.",
        "witness": "Cosign other labs' checkpoints.",
        "sql": "Ask the lab in SQL, read only.",
        "provenance": "Where something comes from, and what came of it.",
        "export": "The lab's records in the formats of others.",
        "diff": "What is different between two moments.",
        "audit": "The tables beside the log that SQL is asked of.",
        "twh": "Time without human intervention.",
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
    **dict.fromkeys(("approvals", "approve", "refuse"), "approvals"),
    **dict.fromkeys(("teach", "locations"), "teach"),
    **dict.fromkeys(("login", "logout", "whoami"), "login"),
}
"""Commands too small for a module of their own."""

_FILES = {**_ONE_FILE, "import": "import_", "handover-report": "handover_report", "take-over": "take_over"}
"""Modules that are not called as their command is."""


class Lazy(Suggesting):
    """Loads a command's module when it is called, so that each starts fast and a broken one
    spoils no other."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for name in COMMANDS if find_spec(_module(name)) is not None]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS or find_spec(_module(cmd_name)) is None:
            return None
        module = import_module(_module(cmd_name))
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


def _module(name: str) -> str:
    return f"labos.cli.{_FILES.get(name, name)}"


@click.group(
    cls=Lazy,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=f"Start with `labos demo`. Each command tells more with --help.\n\n{IN_ONE_LINE}",
)
@click.version_option(package_name="labos-sdl", prog_name="labos")
def group() -> None:
    """LabOS runs a self-driving laboratory: workflows on instruments, every step in a log.

    A lab lives in a folder (--home or LABOS_HOME, ./lab if neither is given) with its database
    (--database or LABOS_DATABASE_URL, a SQLite file in that folder if neither is given). A lab on
    another computer is named by its address, in LABOS_URL. Terms are explained in docs/glossary.md.
    """


def main(argv: list[str] | None = None) -> int:
    """Run the command line; returns the exit code, one of ``labos.cli._exit.CODES``. With ``--json``, what
    went wrong is JSON on standard output too."""
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
        # Whoever read our lines has enough, as `head` does.
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
    from labos.http.problems import plain_error

    show_json(plain_error(error))


def _show_misuse(error: click.ClickException) -> None:
    from labos.cli._out import show_json

    remedy = "See --help of the command."
    show_json({"error": error.format_message(), "remedy": remedy, "code": "misused", "details": []})


def _describe_system_error(error: OSError) -> SystemFailed:
    """What a file, a folder or the network refuses, in the shape of our own errors."""
    what = f"{error.filename}: " if error.filename else ""
    reason = error.strerror or str(error) or type(error).__name__
    remedy = {
        errno.ENOSPC: "Free some space on its disk, then try again.",
        errno.EROFS: "Name a folder that may be written, or mount its disk for writing.",
        errno.EACCES: "Let the user who runs LabOS read and write it, or name another.",
        errno.EPERM: "Let the user who runs LabOS read and write it, or name another.",
    }.get(error.errno or 0, "LABOS_DEBUG=1 shows where it happened.")
    return SystemFailed(f"{what}{reason}.", remedy=remedy)
