"""Groups of commands that suggest a command for an unknown name."""

from __future__ import annotations

import difflib

import click

MEANT = {
    "start": "up",
    "serve": "up",
    "status": "runs",
    "queue": "runs",
    "ps": "runs",
    "stop": "cancel",
    "kill": "cancel",
    "abort": "cancel",
    "emergency-stop": "estop",
    "questions": "interventions",
    "answer": "resolve",
    "history": "log",
    "events": "log",
    "modules": "nodes",
    "instruments": "nodes",
    "check": "validate",
    "lint": "validate",
    "why": "explain",
    "plates": "labware",
    "campaigns": "campaign",
    "reserve": "book",
    "reservations": "bookings",
    "schedule": "calendar",
    "maintenance": "book",
    "convert": "import",
}
"""Names in other programs, and the LabOS command for the same purpose."""


class Suggesting(click.Group):
    """Suggests a command if there is none of the given name."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0] if args else ""
        if name and not name.startswith("-") and self.get_command(ctx, name) is None:
            ctx.fail(f"There is no command {name!r}.{self._remedy(ctx, name)}")
        return super().resolve_command(ctx, args)

    def _remedy(self, ctx: click.Context, name: str) -> str:
        known = self.list_commands(ctx)
        meant = MEANT.get(name.lower(), name.lower())
        if meant in known:
            return f" Did you mean {meant!r}?"
        near = difflib.get_close_matches(name.lower()[:40], known, n=2, cutoff=0.6)
        return f" Did you mean {' or '.join(map(repr, near))}?" if near else ""
