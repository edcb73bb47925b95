"""The event store: the log, its snapshots and its blobs, on SQLite or PostgreSQL."""

from labos.store._accounts import SqlAccounts, open_accounts
from labos.store._accounts_copy import AccountsCopy, copy_accounts, put_accounts_back, read_accounts_copy
from labos.store._archive import move_old_segments
from labos.store._backend import Holder
from labos.store._backup import backup, key_of, read_backup, records_of, verify_backup, verify_detached
from labos.store._blobs import FolderBlobs
from labos.store._errors import TranslatedErrors
from labos.store._event_store import SqlEventStore
from labos.store._home import ERASURES, forget_end, read_erasures
from labos.store._lease import (
    find_database_file,
    find_lease_holder,
    find_silent_holder,
    is_replica,
    measure_database,
    show_url,
)
from labos.store._migrate import (
    DatabaseStatus,
    find_migrations_folder,
    migrate,
    read_database_status,
)
from labos.store._objects import Blobs, ObjectBlobs, open_blobs
from labos.store._open import open_store, scrub_words
from labos.store._restore import leap_epoch, raise_epoch, refuse_to_overwrite, restore_log
from labos.store._roles import grant_writer
from labos.store._segment import encode_record, read_segment, write_segment
from labos.store._url import display_name, find_sqlite_path, parse_url
from labos.store._verify import Damage, Progress, find_first_damage
from labos.store._words_copy import read_words_copy

__all__ = [
    "ERASURES",
    "AccountsCopy",
    "Blobs",
    "Damage",
    "DatabaseStatus",
    "FolderBlobs",
    "Holder",
    "ObjectBlobs",
    "Progress",
    "SqlAccounts",
    "SqlEventStore",
    "TranslatedErrors",
    "backup",
    "copy_accounts",
    "display_name",
    "encode_record",
    "find_database_file",
    "find_first_damage",
    "find_lease_holder",
    "find_migrations_folder",
    "find_silent_holder",
    "find_sqlite_path",
    "forget_end",
    "grant_writer",
    "is_replica",
    "key_of",
    "leap_epoch",
    "measure_database",
    "migrate",
    "move_old_segments",
    "open_accounts",
    "open_blobs",
    "open_store",
    "parse_url",
    "put_accounts_back",
    "raise_epoch",
    "read_accounts_copy",
    "read_backup",
    "read_database_status",
    "read_erasures",
    "read_segment",
    "read_words_copy",
    "records_of",
    "refuse_to_overwrite",
    "restore_log",
    "scrub_words",
    "show_url",
    "verify_backup",
    "verify_detached",
    "write_segment",
]
