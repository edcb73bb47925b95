"""The tables beside the log, and their views for people. One definition is the source of the tables, the
views, ``labos sql --views`` and the reference page. Names and columns of the views are the same on SQLite and
PostgreSQL, and later versions only add to them.
"""

from __future__ import annotations

from labos.audit._bench_tables import BENCH_TABLES
from labos.audit._columns import Column, Table, list_view_columns
from labos.audit._entry_tables import ENTRIES
from labos.audit._work_tables import WORK_TABLES

__all__ = ["TABLES", "VERSION", "VIEWS", "Column", "Table", "list_view_columns"]

VERSION = 9
"""Increase it whenever a table or its content changes: older tables are then made again from the log."""

TABLES = (*WORK_TABLES, *BENCH_TABLES, ENTRIES)
VIEWS = tuple(table for table in TABLES if table.view)
