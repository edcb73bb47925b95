"""The search index: one row for each thing that can be found by words."""

from __future__ import annotations

from labos.audit._columns import MODULE, Table, json, make_words_column, text, time, whole

KINDS = ("experiment", "run", "sample", "image", "file", "result", "publication")

ENTRIES = Table(
    "entry",
    "The search index (`labos find`): experiments, runs, samples, images, files, results and publications.",
    ("number",),
    (
        whole("number", "Its number in the index, for internal use."),
        text("kind", "experiment, run, sample, image, file, result or publication."),
        text("name", "Its name in other commands: E1, R1, `P7/B7`, `R1#3`, a SHA-256, `E1@2041`."),
        make_words_column("title", "Its title."),
        make_words_column("about", "Further text about it; empty if none."),
        time("at", "The time at which it started, was registered, was returned or was published."),
        text("user_id", "The user to whom it belongs."),
        text("workcell", "The workcell in which it was made; empty if it belongs to no workcell."),
        text("workflow", "The workflow; for an experiment and its publications, the application."),
        text("experiment", "The experiment; empty if it belongs to none."),
        text("run", "The run; empty if it belongs to none."),
        MODULE,
        text(
            "status", "The status of an experiment or run; `replaced` for a sample whose sheet was replaced."
        ),
        json("keywords", "The keywords of a publication, or the measured quantity of a result."),
        json("creators", "The authors of a publication."),
        json("files", "The name, SHA-256 and size of each of its files."),
        make_words_column("words", "All words by which it can be found, in lower case and without accents."),
    ),
    view="entries",
    indexes=(("kind", "at_s"), ("experiment",), ("run",)),
    searched="words",
)
