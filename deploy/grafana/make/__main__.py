"""``python -m deploy.grafana.make``: write every dashboard's file anew."""

from __future__ import annotations

from deploy.grafana.make.boards import BOARDS, FOLDER
from deploy.grafana.make.parts import text_of

if __name__ == "__main__":
    for board in BOARDS:
        (FOLDER / f"{board.uid}.json").write_text(text_of(board), encoding="utf-8")
