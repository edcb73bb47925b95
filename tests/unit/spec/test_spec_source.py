"""YAML with positions, within bounds."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.errors import SpecError
from labos.spec.durations import parse_duration
from labos.spec.source import MAX_BYTES, Place, make_plain, parse, read


def test_every_key_and_value_remembers_its_place() -> None:
    source = parse("a: 1\nb:\n  - x\n  - c: {d: 'e'}\n")
    assert make_plain(source.data) == {"a": 1, "b": ["x", {"c": {"d": "e"}}]}
    assert source.place(("a",)) == Place(1, 4)
    assert source.place(("a",), key=True) == Place(1, 1)
    assert source.place(("b", 1, "c", "d")) == Place(4, 12)
    assert source.place(("b", 1, "c", "missing")) == Place(4, 8)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("12:30", "12:30"),
        ("2024-01-02", "2024-01-02"),
        ("0x10", 16),
        ("yes", True),
        ("False", False),
        ("~", None),
        ("", None),
        ("'7'", "7"),
        ("!!str 7", "7"),
        (".5", 0.5),
        ("-3", -3),
        ("payload:seal.time", "payload:seal.time"),
    ],
)
def test_values(text: str, value: object) -> None:
    assert parse(f"a: {text}").data["a"] == value


def test_merge_keys_are_filled_in_and_do_not_override() -> None:
    source = parse("base: &b {x: 1, y: 2}\nuse:\n  <<: *b\n  y: 3\n")
    assert make_plain(source.data["use"]) == {"x": 1, "y": 3}


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
DEEP = "a: &a1 [x]\n" + "".join(f"k{n}: &a{n} [*a{n - 1}]\n" for n in range(2, 100))


@pytest.mark.parametrize(
    ("text", "line", "column", "says"),
    [
        ("a: 1\nb: 2\na: 3\n", 3, 1, "is there twice; the first is in line 1"),
        ("a: [1, 2\nb: 3\n", 2, 2, "not YAML"),
        ("a:\n\t- b\n", 2, 1, "not YAML"),
        ("Name\n\nModules\nOt2 - Deck1\n", 1, 1, "not a table"),
        ("", 1, 1, "empty"),
        ("- a\n- b\n", 1, 1, "not a table"),
        ("a: &x [*x]\n", 1, 4, "contains itself"),
        ("a: .nan\n", 1, 4, "not a finite number"),
        ("a: 1\nb: 99999999999999999999\n", 2, 4, "not a number that can be stored"),
        ("a: 1e999\n", 1, 4, "not a finite number"),
        ("a: !!python/name:os.system x\n", 1, 4, "tag"),
        ("a: !thing {b: 1}\n", 1, 4, "tag"),
        ("? [1, 2]\n: 3\n", 1, 3, "single word"),
        ("a: 1\n---\nb: 2\n", 2, 1, "not YAML"),
        ('a: "\\ud800"\n', 1, 4, "half a character"),
        (BOMB, None, None, "too many values"),
        (DEEP, None, None, "nested more than"),
        ("a: " + "[" * 200 + "]" * 200, 1, None, "nested more than"),
        ("a: b: c\n", 1, 5, "not YAML"),
        ("a: \x00\n", 1, 1, "not text"),
    ],
)
def test_faults(text: str, line: int | None, column: int | None, says: str) -> None:
    with pytest.raises(SpecError) as caught:
        parse(text, "f.yaml")
    error = caught.value
    assert says in str(error)
    assert error.file == "f.yaml"
    assert error.remedy
    if line is not None:
        assert error.line == line
    if column is not None:
        assert error.column == column


def test_binary_large_and_missing_files(tmp_path: Path) -> None:
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"a: 1\n\xff\xfe\x00\x01")
    with pytest.raises(SpecError, match="not text") as caught:
        read(binary)
    assert caught.value.line == 2
    large = tmp_path / "l.yaml"
    large.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(SpecError, match="larger than 4 MB"):
        read(large)
    with pytest.raises(SpecError, match="cannot be read"):
        read(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("value", "seconds"),
    [(3, 3), (0.5, 0.5), ("90 s", 90), ("10 min", 600), ("12 h", 43200), ("1.5h", 5400), ("2 days", 172800)],
)
def test_durations(value: object, seconds: float) -> None:
    assert parse_duration(value) == seconds


@pytest.mark.parametrize("value", ["ten", "5 parsecs", True, None, [], "1 2 s", "-"])
def test_what_is_no_duration(value: object) -> None:
    with pytest.raises(ValueError, match=r"duration|unit"):
        parse_duration(value)
