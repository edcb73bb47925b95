"""A run that the lab's own order keeps waiting: what the kernel and the command line say."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from labos.bootstrap import LabThread, descriptions
from labos.cli._orders import ask_order_setting
from labos.cli._query import Where
from labos.cli.explain import command as explain
from labos.cli.runs import command as runs
from labos.client import LabClient
from labos.settings import ORDER, Settings, last_kernel
from labos.spec import parse_workcell
from tests.support.lab_process import until

ARM = """
  - name: arm
    about:
      actions:
        move:
          args: {source: {type: station}, target: {type: station}}
          effects: [{move: {source: "{source}", target: "{target}"}}]
          duration: 10
"""
MACHINE = """
  - name: %s
    about:
      stations: {nest: {}}
      actions: {work: {duration: %d, effects: [{needs: {}}]}, long: {duration: %d, effects: [{needs: {}}]}}
"""
MACHINES = {"lathe": (600, 600), "mill": (300, 3000), "oven": (6000, 6000), "press": (2000, 2000)}
PLACES = ("in1", "in2", "out1", "out2")
STATIONS = [*(f"wc.{place}" for place in PLACES), *(f"{name}.nest" for name in MACHINES)]
CELL = (
    "labos: 1\nname: shop\nmodules:"
    + ARM
    + "".join(MACHINE % (name, *lasts) for name, lasts in MACHINES.items())
    + f"stations: {{{', '.join(f'wc.{place}: {{}}' for place in PLACES)}}}\n"
    + f"locations: {{arm: {{{', '.join(f'{place}: [{n}]' for n, place in enumerate(STATIONS))}}}}}\n"
)


def make_way(name: str, number: int, *work: tuple[str, str]) -> dict[str, object]:
    """A workflow that takes a plate from its own place through machines, (module, action), to its end."""
    lines, at = [f"labos: 1\nname: {name}\nsteps:"], f"wc.in{number}"
    for machine, action in work:
        lines += [_move(f"to {machine}", at, f"{machine}.nest")]
        lines += [f"  - {{name: {machine}, module: {machine}, action: {action}}}"]
        at = f"{machine}.nest"
    lines += [_move("away", at, f"wc.out{number}")]
    return {"name": f"{name}.yaml", "text": "\n".join(lines) + "\n", "files": {}}


def _move(name: str, source: str, target: str) -> str:
    return f"  - {{name: {name}, module: arm, action: move, args: {{source: {source}, target: {target}}}}}"


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[LabThread]:
    monkeypatch.setenv(ORDER, "search")
    settings = Settings.make(tmp_path / "lab", speed=10.0, simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())], grace_s=0.0) as running:
        yield running


@pytest.mark.slow
def test_what_waits_by_the_labs_own_order_is_explained_so(
    lab: LabThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The long work could begin at the mill, which is free: but all ends sooner if the other run, which is
    still at the lathe, goes there first."""
    home = str(lab.settings.home)
    with LabClient(lab.url) as client:
        until(lambda: {m["status"] for m in client.state()["modules"]} == {"IDLE"}, "all are there", 60.0)
        client.control("pause", "lab", "ada")
        for number in (1, 2):
            client.place(f"wc.in{number}", "plate96", "ada")
        long = client.submit(make_way("long", 1, ("mill", "long"), ("press", "work")), user="ada")
        short = client.submit(
            make_way("short", 2, ("lathe", "work"), ("mill", "work"), ("oven", "work")), user="ada"
        )
        client.control("resume", "lab", "ada")

        def is_turning() -> bool:
            return any(m["name"] == "shop/lathe" and m["status"] == "BUSY" for m in client.state()["modules"])

        until(is_turning, "the other run is at the lathe", 60.0)
        view = next(run for run in client.state()["runs"] if run["id"] == long)
    goes_first = f"all work ends sooner if {short} goes first, at "
    assert view["status"] == "queued"
    assert any(wait["why"].startswith(goes_first) for wait in view["waits"])
    told = CliRunner().invoke(explain, [long, "--home", home], catch_exceptions=False).stdout
    assert f"waits: {goes_first}" in told
    assert "It can continue" not in told
    listed = CliRunner().invoke(runs, ["--home", home, "--json"], catch_exceptions=False).stdout
    assert any(why.startswith(goes_first) for why in {r["id"]: r for r in json.loads(listed)}[long]["waits"])

    info = last_kernel(lab.settings.home)
    assert info is not None
    assert info.searches_order
    monkeypatch.setenv(ORDER, "age")  # the kernel's word counts, not the setting of this program
    assert ask_order_setting(Where(lab.settings.home))
    alone = ["--home", str(lab.settings.home / "elsewhere"), "--database", info.database]
    told = CliRunner().invoke(explain, [long, *alone], catch_exceptions=False).stdout
    assert "waits: " in told, "by the log alone"
    assert "It can continue" not in told
