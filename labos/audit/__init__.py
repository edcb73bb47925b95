"""Tables beside the log for people who ask in SQL, and what is answered from them.

``tables`` says which there are, ``projection`` makes rows of events, ``projector`` carries the log over,
``database`` keeps the rows in SQLite or PostgreSQL, ``query`` answers questions without changing anything.
"""
