"""A station is found by every name that a workcell file gives it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import BadInput, NotFound
from labos.http.openapi import document
from labos.http.routes import OPERATIONS
from labos.settings import Settings
from labos.spec import parse_workcell

CELL = """
labos: 1
name: {name}
modules:
  - name: press
    about:
      stations: {{nest: {{}}, "{odd}": {{}}}}
      actions: {{squeeze: {{effects: [{{needs: {{}}}}], duration: 2}}}}
stations:
  press.nest: {{aliases: [{alias}]}}
"""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabClient]:
    cells = [
        parse_workcell(CELL.format(name=name, odd=odd, alias=alias), descriptions())
        for name, odd, alias in [("left", "door", "Front"), ("right", "hatch", "Back")]
    ]
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=1000.0, simulate=True)
    with LabThread(settings, cells) as lab, LabClient(lab.url) as client:
        yield client


@pytest.mark.parametrize(
    "name",
    [
        "right/press.nest",
        "right/press.positions.nest",
        "Back",
        "back",
        "press.Back",
        "right/back",
        "right/Press.Nest",
    ],
)
def test_a_station_by_one_of_its_names(client: LabClient, name: str) -> None:
    client.place(name, "plate96", "ada")
    (there,) = [shown for shown in client.state()["stations"] if shown["labware"]]
    assert there["name"] == "right/press.nest"
    client.unload("right/press.nest", "ada")


@pytest.mark.parametrize("name", ["press.nest", "nest", "press.positions.nest"])
def test_a_name_that_two_workcells_give_is_not_guessed(client: LabClient, name: str) -> None:
    with pytest.raises(BadInput, match="the name of several stations") as told:
        client.place(name, "plate96", "ada")
    assert told.value.remedy == "Write left/press.nest, for example."


@pytest.mark.parametrize("name", ["left/back", "middle/press.nest", "press.hach"])
def test_a_name_that_nobody_bears(client: LabClient, name: str) -> None:
    with pytest.raises(NotFound, match="has no station"):
        client.place(name, "plate96", "ada")


def test_a_module_is_called_module_and_by_its_old_name_too(client: LabClient) -> None:
    known = {"left/press", "right/press"}
    for found in (client.state()["modules"], client.ask_nodes()):
        assert {one["module"] for one in found} == known
        assert all(one["name"] == one["module"] for one in found)
    schemas = document(OPERATIONS)["components"]["schemas"]
    for name in ("ModuleView", "NodeAnswer"):
        assert schemas[name]["properties"]["name"]["deprecated"] is True
        assert "deprecated" not in schemas[name]["properties"]["module"]
