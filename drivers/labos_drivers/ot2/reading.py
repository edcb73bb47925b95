"""Counts the tips that a Python protocol picks up. The protocol is only read, and never run.

Its function ``run`` is followed with what can be known: literals, the values of the run (``LABOS``), loops
over lists and ranges of known length, the protocol's own functions. If the number of tips depends on anything
else, the result is the number counted so far, with the reason for doubt.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from labos.node import Count
from labos_drivers.ot2.calls import (
    PROTOCOL,
    Calls,
    Doubt,
    Function,
    Returned,
    Scope,
    find_tip_uses,
)
from labos_drivers.ot2.expressions import UNKNOWN, apply, combine, is_known


class _Broken(Exception):
    """The protocol has a ``break`` here."""


class _Continued(Exception):
    """The protocol has a ``continue`` here."""


class _Raised(Exception):
    """The protocol raises an error here."""


def count_tips(content: bytes, values: Mapping[str, Any]) -> Count:
    """The tips of a protocol with the values of its run: as its ``resources`` say, else counted."""
    reader = _Reader()
    try:
        tree = ast.parse(content)
        top = Scope()
        reader.read_all(tree.body, top)
        required = top.get("resources")
        tips = required.get("tips") if isinstance(required, dict) else None
        if isinstance(tips, int | float) and not isinstance(tips, bool) and 0 <= tips < math.inf:
            return Count(float(tips))
        top["LABOS"] = dict(values)
        reader.run(top, tree)
    except Doubt as doubt:
        return Count(reader.tips, str(doubt))
    except (SyntaxError, ValueError) as error:
        return Count(reader.tips, f"it is not Python ({error})")
    except (RecursionError, MemoryError):
        return Count(reader.tips, "it is too deeply nested")
    return Count(reader.tips)


class _Reader(Calls):
    """Reads the statements of a protocol."""

    def __init__(self) -> None:
        super().__init__()
        self._skipped: set[ast.stmt] = set()

    def run(self, top: Scope, tree: ast.Module) -> None:
        """Read ``run``. Raises Doubt, also if a place that takes tips was neither reached nor skipped."""
        run = top.get("run")
        if not isinstance(run, Function):
            raise Doubt("it has no `run`")
        with suppress(_Raised):
            self.enter(run, [PROTOCOL], {})
        left = [node for node in find_tip_uses(tree) if node not in self.counted]
        if left:
            raise Doubt(f"line {left[0].lineno}: whether `{left[0].attr}` is done cannot be determined")

    def read_all(self, body: Sequence[ast.stmt], scope: Scope) -> None:
        for statement in body:
            self.step()
            self.where = statement.lineno
            self._read_statement(statement, scope)

    def _read_statement(self, node: ast.stmt, scope: Scope) -> None:
        match node:
            case ast.Expr():
                self.evaluate(node.value, scope)
            case ast.Assign() | ast.AnnAssign() | ast.AugAssign():
                self._give(node, scope)
            case ast.FunctionDef() if not node.decorator_list:
                self._define(node, scope)
            case ast.If():
                self._branch(node, scope)
            case ast.For():
                self._loop(node, scope)
            case ast.While():
                self._while(node, scope)
            case ast.Try():
                self._try(node, scope)
            case ast.With():
                for item in node.items:
                    value = self.evaluate(item.context_expr, scope)
                    if item.optional_vars is not None:
                        self.assign(item.optional_vars, value, scope)
                self.read_all(node.body, scope)
            case ast.Return():
                self._leave(Returned(self.evaluate(node.value, scope) if node.value is not None else None))
            case ast.Break():
                self._leave(_Broken())
            case ast.Continue():
                self._leave(_Continued())
            case ast.Raise():
                raise _Raised
            case ast.Global() | ast.Nonlocal():
                scope.elsewhere.update(node.names)
            case ast.Import() | ast.ImportFrom():
                for name in node.names:
                    scope.put((name.asname or name.name).partition(".")[0], UNKNOWN)
            case ast.Pass() | ast.Assert() | ast.Delete():
                pass
            case _:
                self.forget(node, scope)

    def _leave(self, by: Exception) -> None:
        if self.bound:
            raise Doubt(self.bound)
        raise by

    def _give(self, node: ast.Assign | ast.AnnAssign | ast.AugAssign, scope: Scope) -> None:
        if node.value is None:
            return
        value = self.evaluate(node.value, scope)
        if isinstance(node, ast.AugAssign):
            before = self.evaluate(node.target, scope)
            self.spoil(before)  # for a list, `+=` changes the list itself
            value = combine(type(node.op), before, value)
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            self.assign(target, value, scope)

    def _define(self, node: ast.FunctionDef, scope: Scope) -> None:
        named = [*node.args.posonlyargs, *node.args.args]
        late = named[len(named) - len(node.args.defaults) :]
        pairs = [*zip(late, node.args.defaults, strict=True)]
        pairs += [
            (arg, default)
            for arg, default in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
            if default is not None
        ]
        defaults = {arg.arg: self.evaluate(default, scope) for arg, default in pairs}
        scope.put(node.name, UNKNOWN if self.unsure else Function(node, scope, defaults, [*self.walk(node)]))

    def assign(self, target: ast.expr, value: Any, scope: Scope) -> None:
        match target:
            case ast.Name():
                scope.put(target.id, UNKNOWN if self.unsure else value)
            case ast.Tuple() | ast.List():
                plain = isinstance(value, list | tuple) and len(value) == len(target.elts)
                starred = any(isinstance(item, ast.Starred) for item in target.elts)
                for index, item in enumerate(target.elts):
                    known = value[index] if plain and not starred else UNKNOWN
                    self.assign(item.value if isinstance(item, ast.Starred) else item, known, scope)
            case ast.Subscript():
                held, key = self.evaluate(target.value, scope), self.evaluate(target.slice, scope)
                plain = isinstance(held, list | dict) and is_known(key) and not self.unsure
                if not plain or apply(held.__setitem__, key, value) is UNKNOWN:
                    self.spoil(held)

    # -- branches and loops ------------------------------------------------------------------

    def _branch(self, node: ast.If, scope: Scope) -> None:
        decided = self.find_truth(self.evaluate(node.test, scope))
        if decided is not None:
            self._skip(node.orelse if decided else node.body)
            self.read_all(node.body if decided else node.orelse, scope)
            return
        why = f"line {node.lineno}: it depends on information that only the robot has"
        before, counts = self.tips, []
        with self.suppose(why):
            for body in (node.body, node.orelse):
                self.tips = before
                try:
                    self.read_all(body, scope)
                except _Raised:
                    continue
                counts.append(self.tips)
        self.tips = max(counts, default=before)
        if len({*counts}) > 1:
            raise Doubt(why)

    def _loop(self, node: ast.For, scope: Scope) -> None:
        items = self.list_items(self.evaluate(node.iter, scope))
        if items is None:
            self.forget(node, scope)
            return
        if not items:
            self._skip(node.body)
        for item in items:
            self.assign(node.target, item, scope)
            try:
                self.read_all(node.body, scope)
            except _Broken:
                self._skip(node.orelse)
                return
            except _Continued:
                continue
        self.read_all(node.orelse, scope)

    def _while(self, node: ast.While, scope: Scope) -> None:
        while True:
            self.step()
            decided = self.find_truth(self.evaluate(node.test, scope))
            if decided is None:
                self.forget(node, scope)
                return
            if not decided:
                break
            try:
                self.read_all(node.body, scope)
            except _Broken:
                self._skip(node.orelse)
                return
            except _Continued:
                continue
        self._skip(node.body)
        self.read_all(node.orelse, scope)

    def _try(self, node: ast.Try, scope: Scope) -> None:
        try:
            self.read_all([*node.body, *node.orelse], scope)
        except _Raised:
            raise Doubt(f"line {node.lineno}: the steps after an error cannot be determined") from None
        for handler in node.handlers:
            self.forget(handler, scope)
        self.read_all(node.finalbody, scope)

    def _skip(self, body: Sequence[ast.stmt]) -> None:
        """Note that statements are certainly not carried out: the tips there need no count."""
        if body and body[0] not in self._skipped:
            self._skipped.add(body[0])
            for statement in body:
                self.counted.update(self.find_tip_uses(statement))
