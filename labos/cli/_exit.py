"""What the exit code of a command says."""

from __future__ import annotations

DONE, FAILED, MISUSED, INTERRUPTED = 0, 1, 2, 130

CODES = {
    DONE: "done; what was asked about is as it should be",
    FAILED: "refused or failed; or what was asked about has failed, is wrong, or differs",
    MISUSED: "wrong usage: an unknown command or option, a missing argument, a value that is not valid",
    INTERRUPTED: "Ctrl-C before it was done; what runs until Ctrl-C, such as `labos up`, ends with 0",
}

IN_ONE_LINE = "Exit codes: 0 done, 1 refused or failed, 2 wrong usage, 130 Ctrl-C."
