"""Tables beside the log for SQL queries, and everything that is answered from them. ``tables`` defines the
tables, ``projection`` makes rows from events, ``projector`` projects the log, ``database`` stores the rows in
SQLite or PostgreSQL, and ``query`` answers read-only queries.
"""
