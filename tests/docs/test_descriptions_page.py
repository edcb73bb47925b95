"""The example on the page about descriptions is one."""

from __future__ import annotations

from labos.spec.describing import list_places, load_description
from labos.spec.source import parse
from tests.docs.markdown import DOCS, blocks


def test_the_example_is_read() -> None:
    (example,) = (b for b in blocks((DOCS / "descriptions.md").read_text()) if b.title == "description.yaml")
    file = load_description(parse(example.text, example.title))
    assert list(list_places(file)) == ["nest", "shelf1", "shelf2", "shelf3", "shelf4"]
