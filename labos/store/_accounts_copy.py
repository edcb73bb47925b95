"""The accounts in a backup: a file beside the segments that is written anew with each backup.

Accounts are not part of the log, because they can be erased. The same holds for their copy: an erased person
is removed from the backup's folder by the next backup into it. Sessions of browsers are not copied.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
from sqlalchemy import LargeBinary, Table, insert, select

from labos.core.seals import add_seal, check_seal
from labos.errors import BadInput, Refused
from labos.private import replace_file
from labos.store._accounts import SqlAccounts
from labos.store._tables import account_identity, account_password, account_person, account_token

FORMAT = 1
FILE = "accounts.json"
TABLES = (account_person, account_password, account_token, account_identity)


class AccountsCopy(msgspec.Struct, frozen=True):
    """The rows of each table, by its name; bytes as hexadecimal digits. ``seal`` is empty without a key."""

    format: int
    lab: str
    copied_at: int
    tables: dict[str, list[dict[str, Any]]]
    seal: str = ""

    @property
    def users(self) -> int:
        """The number of users with any data."""
        return len({row["user_id"] for rows in self.tables.values() for row in rows})


def copy_accounts(
    accounts: SqlAccounts, lab: str, folder: Path, now_ns: int, key: bytes = b""
) -> AccountsCopy:
    """Write the present accounts into a backup's folder, and replace the earlier copy."""
    with accounts.read() as connection:
        tables = {
            table.name: [_make_plain_row(row._asdict()) for row in connection.execute(select(table))]
            for table in TABLES
        }
    made = add_seal(AccountsCopy(FORMAT, lab, now_ns, tables), key)
    replace_file(folder / FILE, msgspec.json.format(msgspec.json.encode(made), indent=2) + b"\n")
    return made


def read_accounts_copy(folder: Path, lab: str, key: bytes = b"") -> AccountsCopy | None:
    """The accounts of a backup; None if it has none. Raises BadInput, and Refused for a wrong seal."""
    path = folder / FILE
    if not path.exists():
        return None
    try:
        found = msgspec.json.decode(path.read_bytes(), type=AccountsCopy)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"{path} holds no accounts ({error}).", remedy=_WITHOUT) from None
    if found.format > FORMAT:
        raise BadInput(
            f"{path} was written by a newer LabOS (format {found.format}; this one knows {FORMAT}).",
            remedy="Upgrade this installation: pip install --upgrade labos-sdl",
        )
    try:
        for table in TABLES:
            for row in found.tables.get(table.name, ()):
                _decode_row(table, row)
    except (ValueError, TypeError) as error:
        raise BadInput(
            f"{path} has a row that does not fit the table {table.name} ({error}).", remedy=_WITHOUT
        ) from None
    fault = check_seal(found, key) if found.lab == lab else f"it is of the lab {found.lab}"
    if fault:
        raise Refused(f"The accounts in {path} are not those of this backup: {fault}.", remedy=_WITHOUT)
    return found


_WITHOUT = "Move the file away to restore the log without accounts, then make new ones: labos user password"


def put_accounts_back(accounts: SqlAccounts, copied: AccountsCopy) -> None:
    """Put copied accounts into a database that has none; all or none."""
    with accounts.change() as connection:
        for table in TABLES:
            rows = [_decode_row(table, row) for row in copied.tables.get(table.name, ())]
            if rows:
                connection.execute(insert(table), rows)


def _make_plain_row(row: dict[str, Any]) -> dict[str, Any]:
    return {name: bytes(v).hex() if isinstance(v, bytes | memoryview) else v for name, v in row.items()}


def _decode_row(table: Table, row: dict[str, Any]) -> dict[str, Any]:
    known = {column.name: isinstance(column.type, LargeBinary) for column in table.columns}
    return {name: bytes.fromhex(v) if known[name] else v for name, v in row.items() if name in known}
