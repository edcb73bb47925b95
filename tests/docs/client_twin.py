"""Writes the asynchronous twins of the client's classes from their signatures, for ``client_code``."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from labos.client import Experiment, LabClient
from labos.client._generated import GeneratedCalls
from labos.client._logged import Loop
from tests.docs.markdown import ROOT

FOLDER = ROOT / "labos" / "client" / "_generated"

WAITING = {"run", "wait", "status", "reset"}
"""Methods that may wait for a long time; so may all of an experiment, and what iterates."""

PAGES = {"events": "_pages_of_events"}
"""Methods whose items come in pages, and what gives those."""

YIELDED = {"Loop": Loop}
"""What a block of an experiment yields, which has calls of its own."""

BEFORE = {"close": "self.threads.give_up()"}

SOURCES = {
    "Any": "typing",
    "Image": "PIL.Image",
    "Attempts": "labos.services.compute",
    "Callable": "collections.abc",
    "Flow": "labos.client._flows",
    "FlowResult": "labos.client._flows",
    "GlobusCarrier": "labos.services.globus",
    "GlobusFlow": "labos.services.globus",
    "GlobusIndex": "labos.services.globus",
    "Future": "concurrent.futures",
    "Iterable": "collections.abc",
    "Loop": "labos.client._logged",
    "Mapping": "collections.abc",
    "Path": "pathlib",
    "Place": "labos.client._transfers",
    "Progress": "labos.client._progress",
    "Generator": "numpy.random",
    "Random": "random",
    "Put": "labos.client._runs",
    "Readings": "labos.services.results",
    "RunResult": "labos.client._results",
    "Sequence": "collections.abc",
    "TracebackType": "types",
    "Transferred": "labos.client._transfers",
}
"""Where the names in signatures come from, if their modules do not say so as they run."""

BUILTIN = {"str", "int", "float", "bool", "bytes", "dict", "list", "tuple", "object", "type", "None", "set"}
BUILTIN |= {"BaseException"}

_names: dict[str, str] = {}


def files() -> dict[Path, str]:
    """The modules of the twins."""
    return {
        FOLDER / "twin_calls.py": _module(_calls, ["labos.client._lab.LabClient"]),
        FOLDER / "twin.py": _module(
            lambda: "\n\n\n".join([_lab(), _experiment(), *map(_write_class, YIELDED)]),
            ["labos.client._experiment.Experiment", "labos.client._generated.twin_calls.AsyncCalls"],
        ),
    }


def _module(write: Callable[[], str], needed: list[str]) -> str:
    _names.clear()
    classes = write()
    imports = "\n".join(f"from {module} import {name}" for name, module in sorted(_names.items()))
    needed = [*needed, "labos.client._lab.LabClient", "labos.client._threads.Threads"]
    own = "\n".join(f"from {name.rpartition('.')[0]} import {name.rpartition('.')[2]}" for name in needed)
    return (
        '"""The client for programs that work with asyncio: written by tests/docs/client_twin.py."""\n\n'
        f"from __future__ import annotations\n\nfrom typing import TYPE_CHECKING\n{own}\n\n"
        f"if TYPE_CHECKING:\n{textwrap.indent(imports, '    ')}\n\n\n{classes}\n"
    )


def _calls() -> str:
    return f'''class AsyncCalls:
    """One method for each operation."""

    sync: LabClient
    threads: Threads

{_members(LabClient, is_generated)}'''


def is_generated(member: Any) -> bool:
    return str(getattr(member, "__module__", "")).startswith(GeneratedCalls.__module__)


def _lab() -> str:
    signature, given = _signature(LabClient.__init__)
    return f'''class AsyncLabClient(AsyncCalls):
    """As ``LabClient``, which stands behind it as ``sync``, with methods to be awaited. A call that is
    cancelled may have been done. What a ``RunResult`` asks the lab for, it asks without waiting for others:
    use ``readings``, ``file`` and the like of this class in its place."""

    def __init__({signature}) -> None:
        self.sync = LabClient({given})
        self.threads = Threads()

    async def __aenter__(self) -> AsyncLabClient:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.close()

{_attributes_of(LabClient)}

{_members(LabClient, lambda member: not is_generated(member))}'''


def _experiment() -> str:
    _names["TracebackType"] = "types"
    signature, given = _signature(Experiment.__init__)
    given = re.sub(r"^lab\b", "lab.sync", given)
    given = given.replace("part_of=part_of", "part_of=part_of.sync if part_of is not None else None")
    return f'''class AsyncExperiment:
    """As ``Experiment``, which stands behind it as ``sync``, with methods to be awaited::

        async with AsyncLabClient(home="lab") as lab, AsyncExperiment(lab, "mix", "ada") as experiment:
            result = await experiment.run("mix.yaml")
    """

    def __init__({signature}) -> None:
        self.lab = lab
        self.sync: Experiment = Experiment({given})
        self.threads = lab.threads

    async def __aenter__(self) -> AsyncExperiment:
        try:
            await self.threads.wait(self.sync.__enter__)
        except BaseException:
            self.sync._over.set()  # nobody is in the block: no heartbeat says so
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.threads.wait(self.sync.__exit__, kind, error, trace)

{_attributes_of(Experiment)}

{_members(Experiment, lambda member: True)}'''


def _write_class(name: str) -> str:
    _names[name] = SOURCES[name]
    return f'''class Async{name}:
    """As ``{name}``, with methods to be awaited."""

    def __init__(self, sync: {name}, threads: Threads) -> None:
        self.sync = sync
        self.threads = threads

{_attributes_of(YIELDED[name])}

{_members(YIELDED[name], lambda member: True)}'''


def _attributes_of(cls: type) -> str:
    parts = [_attribute(name, kind) for name, kind in _attributes(cls) if name != "lab"]
    return textwrap.indent("\n\n".join(parts), "    ")


def _members(cls: type, is_meant: Callable[[Any], bool]) -> str:
    parts = []
    for name, member in sorted(inspect.getmembers_static(cls)):
        if name.startswith("_") or not is_meant(member):
            continue
        if isinstance(member, property):
            assert member.fget is not None
            parts.append(_attribute(name, _note_type(inspect.signature(member.fget).return_annotation)))
        elif inspect.isfunction(member):
            parts.append(_method(cls, name, member))
        else:
            assert isinstance(member, str | int | float), f"{cls.__name__}.{name} has no twin"
    return textwrap.indent("\n\n".join(parts), "    ")


def _attribute(name: str, kind: str) -> str:
    return f"@property\ndef {name}(self) -> {kind}:\n    return self.sync.{name}"


def _attributes(cls: type) -> Iterator[tuple[str, str]]:
    """The public attributes that are set as an object is made, with their types."""
    said = inspect.signature(cls.__init__).parameters  # type: ignore[misc]
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(cls.__init__)))):  # type: ignore[misc]
        match node:
            case ast.AnnAssign(target=ast.Attribute(attr=name), annotation=kind):
                found = [(name, ast.unparse(kind))]
            case ast.Assign(targets=[ast.Tuple(elts=targets)]):
                found = [(t.attr, str(said[t.attr].annotation)) for t in targets if _is_public(t)]
            case ast.Assign(targets=[ast.Attribute(attr=name)], value=ast.Constant(value=value)):
                found = [(name, type(value).__name__)]
            case ast.Assign(targets=[ast.Attribute(attr=name)], value=ast.Name(id=parameter)):
                found = [(name, str(said[parameter].annotation))]
            case _:
                continue
        yield from ((name, _note_type(kind)) for name, kind in found if not name.startswith("_"))


def _is_public(target: ast.expr) -> bool:
    return isinstance(target, ast.Attribute) and not target.attr.startswith("_")


def _method(cls: type, name: str, function: Callable[..., Any]) -> str:
    signature, given = _signature(function)
    if cls is Experiment and "key" in inspect.signature(function).parameters:
        # The order of calls is that in which they are made here, not in which threads begin.
        about = signature.split(", ")[1].partition(":")[0]
        given = given.replace("key=key", f"key=self.sync._take({name!r}, {about}, key)")
    returns = _note_type(str(inspect.signature(function).return_annotation))
    words = " ".join((inspect.getdoc(function) or "").split())
    first = re.split(r"(?<=\.) (?=[A-Z`])", words)[0]  # the rest is said at the method behind it
    doc = textwrap.wrap(f'"""{first}"""', 98, break_on_hyphens=False) if words else []
    own = f"self.sync.{name}"
    wrapped = getattr(function, "__wrapped__", None)
    if wrapped is not None and inspect.isgeneratorfunction(wrapped):
        _names["AbstractAsyncContextManager"] = "contextlib"
        inner = returns[returns.index("[") + 1 : -1]
        twin = f"Async{inner}" if inner in YIELDED else inner
        head = f"def {name}({signature}) -> AbstractAsyncContextManager[{twin}]:"
        block = f"self.threads.block({own}({given}))"
        if inner in YIELDED:
            block = f"self.threads.block_of({own}({given}), {twin})"
        body = f"return {block}"
    elif returns.startswith("Iterator["):
        _names["AsyncIterator"] = "collections.abc"
        head = f"def {name}({signature}) -> Async{returns}:"
        ask = f"self.sync.{PAGES[name]}" if name in PAGES else own
        body = f"return self.threads.iterate{'_pages' if name in PAGES else ''}({ask}({given}))"
    else:
        how = "wait" if name in WAITING or cls is Experiment else "call"
        head = f"async def {name}({signature}) -> {returns}:"
        body = f"await self.threads.{how}({', '.join(part for part in (own, given) if part)})"
        body = body if returns == "None" else f"return {body}"
        body = f"{BEFORE[name]}\n{body}" if name in BEFORE else body
    return head + "\n" + textwrap.indent("\n".join([*doc, body]), "    ")


def _signature(function: Callable[..., Any]) -> tuple[str, str]:
    """The parameters as they are declared, and as they are handed on."""
    declared, given, is_named = ["self"], [], False
    for parameter in list(inspect.signature(function).parameters.values())[1:]:
        kind = _note_type(str(parameter.annotation))
        kind = re.sub(r"\b(LabClient|Experiment)\b", r"Async\1", kind)
        stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        if parameter.kind is parameter.KEYWORD_ONLY and not is_named:
            declared.append("*")
        is_named = is_named or parameter.kind in (parameter.KEYWORD_ONLY, parameter.VAR_POSITIONAL)
        default = "" if parameter.default is parameter.empty else f" = {parameter.default!r}"
        declared.append(f"{stars}{parameter.name}: {kind}{default}")
        is_keyword = parameter.kind is parameter.KEYWORD_ONLY
        given.append(f"{parameter.name}={parameter.name}" if is_keyword else f"{stars}{parameter.name}")
    return ", ".join(declared), ", ".join(given)


def _note_type(kind: str) -> str:
    """A type, the names of which will be imported."""
    for name in re.findall(r"[A-Za-z_]\w*", re.sub(r"Literal\[[^\]]*\]|'[^']*'", "", kind)):
        if name in SOURCES:
            _names[name] = SOURCES[name]
        else:
            known = name in BUILTIN or name in ("LabClient", "Experiment", "Iterator")
            assert known, f"say in SOURCES where {name} comes from"
    return kind
