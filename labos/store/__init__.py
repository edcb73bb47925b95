"""The event store: the log, its snapshots and its blobs, on SQLite or PostgreSQL."""

from labos.store._blobs import FolderBlobs
from labos.store._event_store import SqlEventStore
from labos.store._lease import database_bytes, database_file, lease_holder, shown_url, silent_holder
from labos.store._lockfile import FileLock
from labos.store._migrate import DatabaseStatus, database_status, migrate, migrations_folder
from labos.store._open import open_store
from labos.store._verify import Damage, Progress, first_damage

__all__ = [
    "Damage",
    "DatabaseStatus",
    "FileLock",
    "FolderBlobs",
    "Progress",
    "SqlEventStore",
    "database_bytes",
    "database_file",
    "database_status",
    "first_damage",
    "lease_holder",
    "migrate",
    "migrations_folder",
    "open_store",
    "shown_url",
    "silent_holder",
]
