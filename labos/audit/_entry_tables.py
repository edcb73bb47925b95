"""The search index: one row for each thing that can be found by words."""

from __future__ import annotations

from labos.audit._columns import MODULE, Table, by_people, json, text, time, whole

KINDS = ("experiment", "run", "sample", "image", "file", "result", "publication")

ENTRIES = Table(
    "entry",
    "The search index (`labos find`): experiments, runs, samples, images, files, results and publications.",
    ("number",),
    (
        whole("number", "Its number in the index, for the projector's own use."),
        text("kind", "experiment, run, sample, image, file, result or publication."),
        text("name", "What other commands call it: E1, R1, `P7/B7`, `R1#3`, a SHA-256, `E1@2041`."),
        by_people("title", "Its title."),
        by_people("about", "What else was said of it; empty if nothing was."),
        time("at", "When it began, was registered, was returned or was published."),
        text("user_id", "Whose it is."),
        text("workcell", "Where it was made; empty for what has no workcell of its own."),
        text("workflow", "The workflow or, of an experiment and its publications, the application."),
        text("experiment", "The experiment; empty if it belongs to none."),
        text("run", "The run; empty if it belongs to none."),
        MODULE,
        text("status", "Of experiments and runs as there; of a sample whose sheet was replaced `replaced`."),
        json("keywords", "Of a publication those that it names, of a result what was measured."),
        json("creators", "Who made what is published."),
        json("files", "Name, SHA-256 and size of its files."),
        by_people("words", "All words by which it is found, in small letters and without accents."),
    ),
    view="entries",
    indexes=(("kind", "at_s"), ("experiment",), ("run",)),
    searched="words",
)

ENTRY_TABLES = (ENTRIES,)
