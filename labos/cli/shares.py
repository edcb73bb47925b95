"""``labos shares``: each user's intended and used share of the lab."""

from __future__ import annotations

from pathlib import Path

import click

from labos.cli._lab import need_lab_of
from labos.cli._options import user_option
from labos.cli._out import end_with_json, show_table
from labos.cli._query import Where, log_and_json, now_ns, open_log
from labos.core.shares import Quota
from labos.errors import BadInput
from labos.services.log import fold_to
from labos.services.shares import ShareAccount, make_ledger


@click.command("shares", short_help="Show or set each user's share of the lab time.")
@click.option("--apply", "file", metavar="FILE", help="Set weights and quotas from this file.")
@user_option
@log_and_json
def command(where: Where, file: str | None, user: str) -> None:
    """Show the ledger of lab time: each user's share by weight, and the used share.

    Used time has a half-life of one day: after a day it counts half. Hours are those of the last seven
    days.

    \b
    labos shares                        the ledger
    labos shares --apply shares.yaml    set weights and quotas
    """
    if file is not None:
        with need_lab_of(where) as client:
            client.apply_shares(read_file(file), file, user)
    with open_log(where) as store:
        accounts = make_ledger(fold_to(store, store.head().position), now_ns())
    end_with_json(accounts)
    titles = ("user", "group", "weight", "share", "has had", "hours", "running", "waiting", "quota")
    show_table(titles, [_row(account) for account in accounts])


def _row(account: ShareAccount) -> tuple[str, ...]:
    return (
        account.user,
        account.group,
        f"{account.weight:g}",
        f"{account.wanted:.1%}",
        f"{account.had:.1%}",
        f"{account.lab_hours:.1f}",
        str(account.running),
        str(account.queued),
        _describe_quota(account.quota),
    )


def _describe_quota(quota: Quota) -> str:
    parts = [
        f"{quota.running} running" if quota.running else "",
        f"{quota.queued} waiting" if quota.queued else "",
        f"{quota.lab_hours:g} h a week" if quota.lab_hours else "",
        *(f"{amount:g} {kind} a week" for kind, amount in quota.consumables.items()),
        "" if quota.priority is None else f"priority {quota.priority} at most",
    ]
    return ", ".join(filter(None, parts))


def read_file(file: str) -> str:
    try:
        return Path(file).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"The file {file!r} cannot be read: {error}.", remedy="Check its path.") from None
