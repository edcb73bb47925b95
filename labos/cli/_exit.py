"""The exit codes of commands."""

from __future__ import annotations

DONE, FAILED, MISUSED, INTERRUPTED = 0, 1, 2, 130

CODES = {
    DONE: "done, or the checked thing is in order",
    FAILED: "refused or failed; or the checked thing has failed, is wrong, or differs",
    MISUSED: "wrong usage: an unknown command or option, a missing argument, a value that is not valid",
    INTERRUPTED: "Ctrl-C before the end; commands that run until Ctrl-C, such as `labos up`, end with 0",
}

IN_ONE_LINE = "Exit codes: 0 done, 1 refused or failed, 2 wrong usage, 130 Ctrl-C."
