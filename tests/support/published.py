"""The log of a lab in which somebody has published something: the audited lab, and an experiment of Eve's."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from labos.core.decide.experiments import EndExperiment, NoteExperiment, StartExperiment
from labos.core.ids import ExperimentId
from labos.store import FolderBlobs
from tests.support.audited import audit_lab, finish_with
from tests.unit.services.logbook import Logbook

PICTURE_CONTENT = b"\x89PNG, nearly"
PICTURE = {
    "file": "plate.png",
    "sha256": hashlib.sha256(PICTURE_CONTENT).hexdigest(),
    "bytes": len(PICTURE_CONTENT),
}
TITLE = "A café's green, mixed"
PUBLISHED: dict[str, Any] = {
    "title": TITLE,
    "about": "One of 128 samples.",
    "keywords": ["green", "Colour mixing"],
    "creators": ["eve", "0000-0002-1825-0097"],
    "files": [PICTURE],
}
LATER_S = 90_000
"""A day later."""


def publish_lab() -> Logbook:
    """Eve's experiment runs a PCR, takes a picture of its plate, decides, and publishes."""
    book = audit_lab()
    book.at(LATER_S)
    within = ExperimentId("E1")
    book.do(StartExperiment("Color_Picker", "eve"), "eve")
    run = book.submit("pcr", "eve", experiment=within)
    finish_with(book, run, {_picture_step(book): {"picture": PICTURE}})
    book.do(NoteExperiment(within, "decision", "a decision", {"better": True}), "eve")
    book.do(NoteExperiment(within, "publication", "a publication", {**PUBLISHED, "runs": [run]}), "eve")
    book.do(NoteExperiment(within, "publication", "odd", {"title": 7, "keywords": "x"}), "eve")
    book.do(EndExperiment(within), "eve")
    return book


def save_published(home: Path) -> None:
    """The lab with its files."""
    publish_lab().save(home)
    FolderBlobs(home / "blobs").put(PICTURE_CONTENT)


def _picture_step(book: Logbook) -> str:
    """The step of the PCR that takes a picture."""
    plans = [known.plan for known in book.state.runs.plans.values()]
    steps = [step for plan in plans if plan.workflow == "pcr" for step in plan.steps]
    return next(step.key for step in steps if step.action == "grab_image")
