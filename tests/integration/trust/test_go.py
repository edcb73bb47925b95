"""An independent verifier: Go's own implementation of signed notes and transparency logs."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from labos.core.merkle import Tree, hash_leaf, list_consistency_ranges, list_inclusion_ranges, make_proof
from labos.services.trust.places import name_checkpoint
from tests.integration.trust.conftest import Lab
from tests.unit.services.logbook import two_users

pytestmark = pytest.mark.slow

SOURCE = Path(__file__).parents[2] / "support" / "go_verifier"
RECORDS = two_users().records
END = len(RECORDS)


@pytest.fixture(scope="module")
def verifier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program, built once; skips where there is no Go, or its module cannot be fetched."""
    made = tmp_path_factory.mktemp("go") / "verifier"
    why = "there is no Go on this machine"
    if shutil.which("go"):
        built = subprocess.run(
            ["go", "build", "-o", str(made), "."], cwd=SOURCE, capture_output=True, text=True, check=False
        )
        if built.returncode == 0:
            return made
        why = built.stderr
    if os.environ.get("LABOS_REQUIRE_GO") == "1":
        pytest.fail(f"LABOS_REQUIRE_GO is set, but {why}")
    pytest.skip(why)


def question(lab: Lab) -> dict[str, Any]:
    """All events and all smaller trees, with proofs."""
    tree = Tree(hash_leaf(record.envelope) for record in RECORDS)
    return {
        "key": lab.public.read_text().strip(),
        "note": _text((lab.safe / name_checkpoint(END)).read_bytes()),
        "records": [
            {
                "index": at,
                "data": _text(record.envelope),
                "proof": [_text(each) for each in make_proof(list_inclusion_ranges(at, END), tree.hash_of)],
            }
            for at, record in enumerate(RECORDS)
        ],
        "older": [
            {
                "size": size,
                "root": _text(tree.compute_root(size)),
                "proof": [
                    _text(each) for each in make_proof(list_consistency_ranges(size, END), tree.hash_of)
                ],
            }
            for size in range(1, END + 1)
        ],
    }


def ask(verifier: Path, asked: dict[str, Any]) -> str:
    done = subprocess.run([verifier], input=json.dumps(asked), capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (done.stdout == "ok\n"), done.stderr
    return done.stdout.strip()


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def test_go_accepts_our_note_and_every_proof(lab: Lab, verifier: Path) -> None:
    assert ask(verifier, question(lab)) == "ok"


def test_go_refuses_what_was_changed(lab: Lab, verifier: Path) -> None:
    good = question(lab)
    note = base64.b64decode(good["note"])
    larger = note.replace(b"\n%d\n" % END, b"\n%d\n" % (END + 1))
    assert larger != note
    assert "invalid signature" in ask(verifier, {**good, "note": _text(larger)})
    other = json.loads(json.dumps(good))
    other["records"][5]["data"] = _text(RECORDS[5].envelope + b" ")
    assert "record 5" in ask(verifier, other)
    other = json.loads(json.dumps(good))
    other["records"][5]["index"] = 6
    assert "record 6" in ask(verifier, other)
    other = json.loads(json.dumps(good))
    other["older"][11]["root"] = _text(bytes(32))
    assert "tree of 12" in ask(verifier, other)
    other = json.loads(json.dumps(good))
    other["older"][11]["size"] = 13
    assert "tree of 13" in ask(verifier, other)
    swapped = good["key"].replace("chem.", "bio.")
    assert "invalid verifier" in ask(verifier, {**good, "key": swapped})
