"""Draws the pictures of the dashboards anew: ``python -m tests.docs.pictures``.

A simulated lab works for a while, a real Prometheus watches it, and every panel is drawn from its own
queries.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from deploy.grafana.make.log import SQLITE
from tests.docs.markdown import DOCS
from tests.support.dashboards import answer_query, boards, busy_lab
from tests.support.drawing import draw

WORKS_S = 90.0


def main() -> None:
    folder = DOCS / "pictures"
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, busy_lab(Path(scratch)) as (_, prometheus):
        time.sleep(WORKS_S)
        for uid, board in boards().items():
            if uid.endswith(SQLITE.ending):
                continue  # it looks as the one on PostgreSQL
            picture = draw(board, lambda target: answer_query(prometheus, target, WORKS_S))
            (folder / f"{uid}.svg").write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    main()
