"""The table of badges: every packaged driver has one, and none is older than its driver."""

from __future__ import annotations

import ast

from tests.docs.badges import _bare, badges, code_of, drivers, read_badges
from tests.docs.markdown import REFERENCE, table


def test_every_driver_has_a_badge_that_is_not_older_than_it() -> None:
    known = read_badges()
    old = [name for name in drivers() if name not in known or known[name].code != code_of(name)]
    assert (old, sorted(known)) == ([], drivers()), (
        "run `python -m tests.docs.badges`, then tests.docs.generate"
    )


def test_what_is_not_silver_says_why() -> None:
    rows = table((REFERENCE / "badges.md").read_text())
    assert [row[0] for row in rows] == drivers()
    assert [row[0] for row in rows if row[1] != "gold" and not row[4]] == []
    assert badges() in (REFERENCE / "badges.md").read_text()


def test_comments_make_no_driver_newer() -> None:
    text = '"""Old words."""\n\ndef f():\n    "Says."\n    return 1\n'
    same = '"""New words."""\n\n# why\ndef f():\n    "Tells."\n    return 1\n'
    assert _bare(text) == _bare(same) != _bare(text.replace("1", "2"))
    assert ast.parse(text)
