"""The tables that stand beside the log, and the views on them that people read.

One definition makes the tables, the views, ``labos sql --views`` and the page of the reference. Names and
columns of the views are the same on SQLite and PostgreSQL and do not change but by addition.
"""

from __future__ import annotations

from labos.audit._bench_tables import BENCH_TABLES
from labos.audit._columns import Column, Table, view_columns
from labos.audit._entry_tables import ENTRY_TABLES
from labos.audit._work_tables import WORK_TABLES

__all__ = ["TABLES", "VERSION", "VIEWS", "Column", "Table", "view_columns"]

VERSION = 9
"""Raise it whenever a table changes, or what stands in it: older ones are then made anew from the log."""

TABLES = (*WORK_TABLES, *BENCH_TABLES, *ENTRY_TABLES)
VIEWS = tuple(table for table in TABLES if table.view)
