"""``labos new`` and ``labos schema``: files to begin with."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.errors import BadInput
from labos.spec.schema import MODELINE
from tests.unit.cli_files.calls import call


def test_a_new_workcell_and_workflow_are_sound_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "labos validate bench.yaml" in call("new", "workcell", "bench")
    call("new", "workflow", "seal.yaml")
    assert call("validate", "bench.yaml") == "bench: 3 modules, 13 stations, no errors.\n"
    told = call("validate", "seal.yaml", "--workcell", "bench.yaml")
    assert told.startswith("seal on bench: 4 steps, no errors.")
    assert call("validate", "seal.yaml", "--workcell", "rpl").startswith("seal on rpl: 4 steps, no errors.")


@pytest.mark.parametrize("kind", ["workcell", "workflow", "app"])
def test_files_name_their_schema(kind: str, tmp_path: Path) -> None:
    written = json.loads(call("new", kind, str(tmp_path / "deep/thing"), "--json"))["written"]
    file = Path(written[-1])
    first = file.read_text().partition("\n")[0]
    assert first.startswith(MODELINE)
    schema = file.parent / first.removeprefix(MODELINE)
    assert schema.read_text() == call("schema", "workflow" if kind == "app" else kind)
    assert len(written) == (2 if kind == "app" else 1)


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    call("new", "app", str(tmp_path / "thing"))
    (tmp_path / "thing.yaml").unlink()
    with pytest.raises(BadInput, match=r"already is .*thing\.py"):
        call("new", "app", str(tmp_path / "thing"))
    assert not (tmp_path / "thing.yaml").exists()
    call("new", "app", str(tmp_path / "thing"), "--force")
    assert (tmp_path / "thing.yaml").exists()


@pytest.mark.parametrize(("kind", "name"), [("workcell", "a.b"), ("workflow", "~"), ("app", "two words")])
def test_names_that_cannot_be(kind: str, name: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be a"):
        call("new", kind, str(tmp_path / name))
    assert list(tmp_path.iterdir()) == []


def test_a_workflow_needs_a_workcell_to_be_checked(tmp_path: Path) -> None:
    call("new", "workflow", str(tmp_path / "f"))
    call("validate", str(tmp_path / "f.yaml"), code=2)
    call("validate", "pcr", code=2)
    (tmp_path / "bad.yaml").write_text("labos: 1\nname: x\nmodules: [{name: a, model: nothing}]\n")
    told = json.loads(call("validate", str(tmp_path / "bad.yaml"), "--json", code=1))
    assert (told["sound"], told["findings"][0]["line"]) == (False, 3)
