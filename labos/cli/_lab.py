"""Finds a spec by its path or name, and a lab to use: the running one, or a lab for this command only."""

from __future__ import annotations

import contextlib
import signal
import sys
from base64 import b64decode
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labos.cli._out import show_lines
from labos.cli._remote import lab_of
from labos.client import LabClient
from labos.errors import NotFound
from labos.settings import Settings, find_kernel, keep_private

if TYPE_CHECKING:
    from labos.cli._query import Where
    from labos.spec import Compiled, CompiledWorkcell, Source


CLOSING = "Closing: waiting for actions in progress, for 30 s at most (Ctrl-C again: at once)."


def find_workcell_file(name: str) -> Path:
    """A workcell file by path, or a packaged one by name. Raises NotFound."""
    path = Path(name)
    if path.is_file():
        return path
    if path.suffix or len(path.parts) > 1:
        raise NotFound(f"There is no workcell file {name!r}.", remedy="Check its path.")
    from labos.spec.library import find_spec

    return find_spec("workcells", name)


def find_spec_path(kind: str, name: str) -> Path:
    """The file at this path if there is one, else the packaged spec of that name. Raises NotFound."""
    from labos.spec import find_spec, list_specs

    path = Path(name)
    if path.is_file():
        return path
    try:
        return find_spec(kind, name)
    except NotFound:
        known = ", ".join(list_specs(kind))
        raise NotFound(
            f"There is neither a file nor a packaged {kind.removesuffix('s')} {name!r}.",
            remedy=f"Packaged are: {known}.",
        ) from None


def read_workcell(name: str, workflows: Sequence[Source] | None = None) -> CompiledWorkcell:
    """Compile a workcell, and show the warnings of its file. If the file of another lab lacks information, it
    is drafted from the ``workflows`` that use it. Raises SpecErrors, NotFound."""
    from labos.bootstrap import descriptions
    from labos.spec import load_workcell
    from labos.spec.uses import read_uses

    uses = None if workflows is None else read_uses(workflows)
    cell = load_workcell(find_workcell_file(name), descriptions(), uses)
    show_lines(cell.findings, "labos: ", err=True)
    return cell


def check_first(
    text: Mapping[str, Any], payload: Mapping[str, Any], cell: CompiledWorkcell, *, simulate: bool
) -> Compiled:
    """Raise the errors that a new lab would raise, before it is started. Raises SpecErrors."""
    from labos.bootstrap import descriptions
    from labos.planning.certified import check_windows
    from labos.spec import compile_workflow, parse_workflow

    compiled = compile_workflow(
        parse_workflow(text["text"], text["name"]),
        payload,
        cell.workcell,
        descriptions(),
        simulate=simulate,
        files={name: b64decode(content) for name, content in text["files"].items()},
        bench=cell.bench,
        left_out=cell.left_out,
    )
    return check_windows(compiled, cell.workcell)


@contextlib.contextmanager
def end_in_order(hurry: Callable[[], None] | None = None) -> Iterator[None]:
    """SIGTERM ends the block in the same way as Ctrl-C. With ``hurry``, only the first signal raises
    KeyboardInterrupt; each later one calls ``hurry``. So no signal is lost, wherever the block is. A Ctrl-C
    that is ignored, as in the background of a script, stays ignored."""
    if sys.platform == "win32":
        yield
        return
    is_ending = False

    def interrupt(*_: Any) -> None:
        nonlocal is_ending
        if is_ending and hurry is not None:
            hurry()
            return
        is_ending = True
        raise KeyboardInterrupt

    numbers = [signal.SIGTERM]
    if hurry is not None and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        numbers.append(signal.SIGINT)
    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def some_lab(settings: Settings, workcells: Sequence[CompiledWorkcell], url: str = "") -> Iterator[LabClient]:
    """The lab at an address, or the lab that runs in the home folder; else a lab with these workcells, for as
    long as the block lasts."""
    running = LabClient(url) if url else find_lab(str(settings.home))
    if running is not None:
        with running as client:
            yield client
        return
    from labos.bootstrap import LabThread

    keep_private()
    lab = LabThread(settings, workcells)
    with end_in_order(lab.hurry), lab, LabClient(lab.url) as client:
        yield client


def find_lab(home: str | None, token: str = "") -> LabClient | None:
    """The lab that LABOS_URL names, else the one that runs in the home folder, if one does. It gets this
    ``token``, by default the stored one."""
    if url := lab_of(home):
        return LabClient(url, token=token)
    folder = Settings.make(home).home
    return None if find_kernel(folder) is None else LabClient(home=folder, token=token)


def need_lab(home: str | None, token: str = "") -> LabClient:
    """As ``find_lab``. Raises NotFound if no lab runs."""
    if (found := find_lab(home, token)) is None:
        folder = Settings.make(home).home
        raise NotFound(f"No lab runs in {folder}.", remedy="Start one with `labos up`, or name its --home.")
    return found


def need_lab_of(where: Where) -> LabClient:
    """As ``need_lab``, for a command that reads the log. Raises NotFound if none runs."""
    return LabClient(where.lab) if where.lab else need_lab(str(where.home))


def find_stations(client: LabClient, names: Sequence[str]) -> dict[str, str]:
    """The stations of labware that was just placed: for a hotel, the shelf."""
    standing = client.state()["labware"] if any(names) else []
    return {item["id"]: item["station"] for item in standing if item["id"] in names and item["station"]}
