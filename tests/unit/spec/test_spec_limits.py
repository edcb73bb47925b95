"""Files made to exhaust whoever reads them are refused, in a process that may not use much."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.processes import run_process

MEMORY_MB = 768
"""Address space that the reading process gets; Python with LabOS' models takes some 200 MB."""

TIMEOUT_S = 110

READER = """\
import json, os, resource, signal, sys, traceback
from labos.errors import SpecError
from labos.spec import read_workflow, validate_workcell, validate_workflow
from labos.spec.findings import make_finding
from labos.core.model import Workcell

def read(path):
    try:
        source = read_workflow(path)
        found = validate_workflow(source, {{}}, Workcell("w", "", (), ()), {{}})
        found += validate_workcell(source, {{}})
    except SpecError as error:
        found = [make_finding(error)]
    assert any(finding.severity == "error" for finding in found), found
    assert all(finding.remedy and len(str(finding)) < 5000 for finding in found), found
    assert len(found) <= 1000, len(found)
    return found[0].message

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, ({memory}, {memory}))
        signal.alarm({timeout_s})
        try:
            told = {{"says": read(line.removesuffix("\\n"))}}
        except BaseException:
            told = {{"fault": traceback.format_exc()[-2000:]}}
        print(json.dumps(told), flush=True)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    if status:
        print(json.dumps({{"fault": f"the reader ended with {{status}}"}}), flush=True)
"""
"""Reads each file in a process of its own, which has inherited what it needs."""


@pytest.fixture(scope="module")
def reader() -> Iterator[subprocess.Popen[str]]:
    code = READER.format(memory=MEMORY_MB * 1024 * 1024, timeout_s=TIMEOUT_S)
    pipe = subprocess.PIPE
    with run_process([sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True) as process:
        yield process


def huge(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(100 * 1024 * 1024)


def text(content: str) -> object:
    return lambda path: path.write_text(content, encoding="utf-8")


def chain(links: int) -> str:
    return "a0: &a0 [x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}]\n" for n in range(1, links))


def bomb(letters: str = "bcdefghijkl") -> str:
    lines = ["a: &a [lol,lol,lol,lol,lol,lol,lol,lol,lol]"]
    before = "a"
    for letter in letters:
        lines.append(f"{letter}: &{letter} [{','.join([f'*{before}'] * 9)}]")
        before = letter
    return "\n".join(lines) + "\n"


def merges(links: int) -> str:
    first = "m0: &m0 {a: 1, b: 2, c: 3}\n"
    rest = (f"m{n}: &m{n}\n  <<: [{','.join([f'*m{n - 1}'] * 20)}]\n  k{n}: 1\n" for n in range(1, links))
    return first + "".join(rest)


HOSTILE = {
    "a hundred megabytes": (huge, "larger than 4 MB"),
    "a billion laughs": (text(bomb()), "too many values"),
    "merged for ever": (text(merges(40)), "too many values"),
    "an alias in itself": (text("a: &a {b: [*a]}\n"), "contains itself"),
    "two aliases in each other": (text("a: &a\n  b: &b\n    c: *a\n  d: *b\n"), "contains itself"),
    "a long chain of aliases": (text(chain(5000)), "nested more than"),
    "brackets without end": (text("a: " + "[" * 2_000_000), "nested more than"),
    "braces without end": (text("{a: " * 500_000), "nested more than"),
    "dashes without end": (text("- " * 1_000_000), "nested more than"),
    "a question of questions": (text("? " * 1_000_000), "nested more than"),
    "a deep staircase": (text("".join(f"{' ' * n}a:\n" for n in range(1500))), "nested more than"),
    "more values than anybody writes": (text("a:\n" + "- 1\n" * 500_000), "more than 100000 values"),
    "binary": (lambda path: path.write_bytes(bytes(range(256)) * 4000), "not text"),
    "zeros": (lambda path: path.write_bytes(bytes(1_000_000)), "not text"),
    "a picture": (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256))), "not text"),
    "UTF-16": (lambda path: path.write_bytes("name: x\n".encode("utf-16")), "not text"),
    "one endless word": (text("name: " + "x" * 1_000_000), "'steps' is missing"),
    "one endless key": (text('? "' + "x" * 1_000_000 + '"\n: 1\nlabos: 1\n'), ""),
    "a number without end": (text("name: " + "1" * 100_000), "not a number that can be stored"),
    "unknown keys": (
        text("labos: 1\nname: x\nsteps: []\n" + "".join(f"stepz{n}: 1\n" for n in range(40_000))),
        "",
    ),
    "unknown steps": (
        text("name: x\nflowdef:\n" + "  - {module: a, action: b, wiat: 1}\n" * 8_000),
        "",
    ),
    "references that never end": (
        text(
            'name: x\nsteps: [{name: a, module: b, action: c, args: {d: "steps.'
            + ".result" * 100_000
            + '!"}}]'
        ),
        "no module",
    ),
    "a duration without end": (
        text(
            'name: x\nsteps: [{name: a, module: b, action: c, wait: {after: a, at_least: "'
            + "1" * 100_000
            + '!"}}]'
        ),
        "duration",
    ),
}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limits")
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_within_bounds(
    name: str, reader: subprocess.Popen[str], tmp_path: Path
) -> None:
    make, says = HOSTILE[name]
    path = tmp_path / "hostile.yaml"
    make(path)  # type: ignore[operator]
    assert reader.stdin is not None
    assert reader.stdout is not None
    print(path, file=reader.stdin, flush=True)
    told = json.loads(reader.stdout.readline())
    assert "fault" not in told, told["fault"]
    assert says in told["says"]


def test_a_file_that_is_no_file_is_refused(tmp_path: Path) -> None:
    from labos.errors import SpecError
    from labos.spec import read_workflow

    with pytest.raises(SpecError, match="cannot be read"):
        read_workflow(tmp_path)


@pytest.mark.parametrize("name", ["a hundred megabytes", "a billion laughs", "an alias in itself", "binary"])
def test_a_client_does_not_choke_on_them_either(name: str, tmp_path: Path) -> None:
    make, _ = HOSTILE[name]
    path = tmp_path / "hostile.yaml"
    make(path)  # type: ignore[operator]
    done = subprocess.run(
        [sys.executable, "-m", "labos", "run", str(path), "--simulate", "--home", str(tmp_path / "lab")],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert (done.returncode, "Traceback" in done.stderr) == (1, False), done.stderr[-2000:]
    assert done.stderr.startswith("labos: ")
    assert not (tmp_path / "lab").exists()
