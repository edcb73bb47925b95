"""What a lab may set of every driver: how long its device may take, and how its line is set."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from typing import Any

import pytest

from labos.errors import DeviceError
from labos.link import TcpEnd
from labos.node import Setup
from labos_drivers._limits import make_serial_wire, read_deadlines
from labos_drivers._wired import OnBenchOrWire, Wired
from labos_drivers.axis.driver import AxisDriver
from labos_drivers.plc.driver import PlcDriver
from tests.docs.markdown import DOCS
from tests.drivers.test_contract import DRIVERS

PAGE = DOCS / "links.md"
USED = re.compile(r'limit_s\(\s*"(\w+)", (\w+)\s*\)')
BY_TABLE: dict[str, type[Wired]] = {"plc": PlcDriver, "axis": AxisDriver}
SHIPPED = {
    "a4s_sealer": "19200 8N1",
    "brooks_peeler": "9600 8N1",
    "inheco": "19200 8N1",
    "liconic": "9600 8E1",
    "pipette": "9600 8N1",
    "platecrane": "9600 8N1",
    "tecan": "9600 8N1",
}
"""Of the drivers that may be at a serial port."""


def list_wired() -> dict[str, type[Wired]]:
    """The drivers of real devices, by package."""
    found: dict[str, type[Wired]] = {}
    for package, name in DRIVERS.items():
        node = getattr(importlib.import_module(f"labos_drivers.{package}"), name)
        if issubclass(node, OnBenchOrWire):
            found[package] = BY_TABLE.get(package) or node.devices[2]
    return found


WIRED = list_wired()


def uses(driver: type[Wired]) -> dict[str, float]:
    """The deadlines that its code asks for, and what they are if a lab says nothing."""
    found = {}
    for kind in driver.__mro__:
        module = importlib.import_module(kind.__module__)
        if not module.__name__.startswith("labos_drivers") or kind is Wired:
            continue
        for part in {module.__name__, f"{module.__name__.rpartition('.')[0]}.source"}:
            try:
                home = importlib.import_module(part)
            except ImportError:
                continue
            found |= {
                name: getattr(home, constant) for name, constant in USED.findall(inspect.getsource(home))
            }
    return found


def test_only_a_person_has_no_wire() -> None:
    assert DRIVERS.keys() - WIRED.keys() == {"operator"}


@pytest.mark.parametrize("package", WIRED)
def test_every_deadline_that_may_be_set_is_kept_to(package: str) -> None:
    driver = WIRED[package]
    assert driver.deadlines, "a lab may know better"
    assert set(uses(driver)) == set(driver.deadlines)


@pytest.mark.parametrize("package", WIRED)
def test_a_deadline_that_there_is_not_is_refused(package: str) -> None:
    known = WIRED[package].deadlines
    config = {"deadlines": {known[0][:-1]: 5}}
    with pytest.raises(DeviceError, match=rf"has no '{known[0][:-1]}'.*{known[0]}") as told:
        read_deadlines(Setup("it", "cell", config), known)
    assert told.value.effects == "none"


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({"heat": "soon"}, "`deadlines: heat:` is 'soon'"),
        ({"heat": -1}, "is -1"),
        ({"heat": float("nan")}, "is nan"),
        ({"heat": True}, "is True"),
        ([5], r"`deadlines:` is \[5\]"),
        ({"haet": 5}, "Did you mean 'heat'"),
    ],
)
def test_what_is_no_deadline_is_said(told: Any, says: str) -> None:
    with pytest.raises(DeviceError, match=says):
        read_deadlines(Setup("it", "cell", {"deadlines": told}), ("heat", "cycle"))


def test_deadlines_are_seconds_or_texts() -> None:
    told = {"heat": "10 min", "cycle": 90}
    assert read_deadlines(Setup("it", "cell", {"deadlines": told}), ("heat", "cycle", "begin")) == {
        "heat": 600.0,
        "cycle": 90.0,
    }


@pytest.fixture
def mute() -> Iterator[TcpEnd]:
    end = TcpEnd()
    yield end
    end.close()


def test_a_device_that_says_nothing_is_waited_for_as_long_as_the_lab_says(mute: TcpEnd) -> None:
    driver = WIRED["pf400"](Setup("arm", "cell", {"deadlines": {"answer": 0.25}}), mute.address)
    with pytest.raises(DeviceError, match=r"within 0\.25 s"):
        driver.link.open()
    driver.link.close()


@pytest.mark.parametrize("package", SHIPPED)
def test_a_serial_line_is_set_as_the_lab_says(package: str) -> None:
    def line(**config: Any) -> str:
        told = {"port": "/dev/ttyX9", **config}
        set_to = WIRED[package](Setup("it", "cell", told), "/dev/ttyX9").link._wire._settings  # type: ignore[attr-defined]
        return f"{set_to['baudrate']} {set_to['bytesize']}{set_to['parity']}{set_to['stopbits']}"

    assert line() == SHIPPED[package]
    assert line(baudrate=57600, parity="O", bytesize=7, stopbits=2) == "57600 7O2"


@pytest.mark.parametrize(
    ("key", "value"),
    [("baudrate", "fast"), ("baudrate", 0), ("parity", "X"), ("stopbits", 3), ("bytesize", True)],
)
def test_a_line_that_cannot_be_set_so_is_refused(key: str, value: Any) -> None:
    with pytest.raises(DeviceError, match=rf"`{key}:` is .*As shipped"):
        make_serial_wire(Setup("it", "cell", {key: value}), "/dev/ttyX9", baudrate=9600)


def rows() -> str:
    """The table of the page."""
    lines = [
        "| driver | `deadlines:`, and what they are if left out (s) | its line, as shipped |",
        "| --- | --- | --- |",
    ]
    for package, driver in WIRED.items():
        limits = uses(driver)
        told = ", ".join(f"`{name}` {limits[name]:g}" for name in driver.deadlines)
        lines.append(f"| {package} | {told} | {SHIPPED.get(package, '')} |".replace("|  |", "| |"))
    return "\n".join(lines)


def test_the_page_tells_all_of_them() -> None:
    shown = PAGE.read_text().partition("<!-- deadlines -->\n")[2].partition("<!-- end -->")[0]
    assert shown.strip() == rows()
