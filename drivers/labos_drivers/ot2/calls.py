"""Evaluates the expressions of a Python protocol and counts the tips that its calls pick up.

``pick_up_tip`` picks up tips, and each complex command does so once, unless ``new_tip`` says otherwise. If a
pipette, or the protocol itself, is passed to code that is not followed, the number of tips is in doubt.
Source: docs.opentrons.com, Python Protocol API 2, "Pipette tips" and "Complex commands".
"""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from labos_drivers.ot2.expressions import (
    COMPARISONS,
    UNARY,
    UNKNOWN,
    apply,
    call_builtin,
    combine,
    is_flat,
    is_known,
    item_of,
    parts_of,
)

COMPLEX = ("transfer", "distribute", "consolidate")
OF_A_CLASS = tuple(f"{name}_with_liquid_class" for name in COMPLEX)
TAKES = {"pick_up_tip", *COMPLEX, *OF_A_CLASS, "configure_nozzle_layout"}
"""Methods of a pipette that decide how many tips are used up."""
MOST_STEPS, MOST_LOOKED_AT = 100_000, 500_000
"""Statements that are gone through, and parts of them that are looked at: a file that has more is left."""
DEEPEST = 40
UNHARMFUL = {"print", "len", "isinstance", "range", "next", "iter", "str", "type"}
"""Functions of Python that do nothing to what they are given."""


class Doubt(Exception):
    """The reason why a number of tips is not certain, as a clause for a longer sentence."""


class Protocol:
    """Stands for the ``ProtocolContext``, the argument of ``run``."""


PROTOCOL: Final = Protocol()


class Pipette:
    def __init__(self, name: Any) -> None:
        self.name = name
        self.has_tip: Any = False


class Function:
    """A function that the protocol defines, with the scope around it."""

    def __init__(
        self, node: ast.FunctionDef, scope: Scope, defaults: dict[str, Any], inside: list[ast.AST]
    ) -> None:
        self.node, self.scope, self.defaults = node, scope, defaults
        self.names = {part.id for part in inside if isinstance(part, ast.Name)}
        self.yields = any(isinstance(part, ast.Yield | ast.YieldFrom) for part in inside)


class Scope(dict[str, Any]):
    def __init__(self, outer: Scope | None = None) -> None:
        super().__init__()
        self.outer = outer
        self.elsewhere: set[str] = set()

    def find(self, name: str) -> Any:
        if name in self:
            return self[name]
        return self.outer.find(name) if self.outer is not None else None

    def put(self, name: str, value: Any) -> None:
        scope = self.outer if name in self.elsewhere else self
        while scope is not None and name in self.elsewhere and name not in scope and scope.outer is not None:
            scope = scope.outer
        (scope if scope is not None else self)[name] = value


class Returned(Exception):
    def __init__(self, value: Any) -> None:
        self.value = value


class Calls(ABC):
    """Evaluates expressions and counts tips. ``where`` is the present line. While ``unsure`` has a reason, it
    is not known whether the code that is read is carried out. While ``bound`` has a reason, ``return``,
    ``break`` and ``continue`` raise Doubt."""

    def __init__(self) -> None:
        self.tips = 0.0
        self.where = 0
        self.unsure = self.bound = ""
        self._steps = self._depth = self._looked_at = 0
        self._spoiled: dict[int, Any] = {}
        self.counted: set[ast.Attribute] = set()
        self._takes: dict[ast.AST, list[ast.Attribute]] = {}

    @abstractmethod
    def read_all(self, body: Sequence[ast.stmt], scope: Scope) -> None:
        """Read statements in their order. Raises Doubt."""

    @abstractmethod
    def assign(self, target: ast.expr, value: Any, scope: Scope) -> None:
        """Assign a value to the target of an assignment."""

    def step(self) -> None:
        """Count one more statement. Raises Doubt if there are too many."""
        self._steps += 1
        if self._steps > MOST_STEPS:
            raise Doubt(f"it has more than {MOST_STEPS} steps")

    def find_tip_uses(self, node: ast.AST) -> list[ast.Attribute]:
        """The places in a syntax tree at which tips are taken. Each tree is searched only once."""
        if node not in self._takes:
            self._takes[node] = list(find_tip_uses(node))
        return self._takes[node]

    def walk(self, node: ast.AST) -> Iterator[ast.AST]:
        """All parts of a syntax tree. Raises Doubt if too many parts were looked at in all."""
        for part in ast.walk(node):
            self._looked_at += 1
            if self._looked_at > MOST_LOOKED_AT:
                raise Doubt("it is too long")
            yield part

    # -- values of expressions ---------------------------------------------------------------

    def evaluate(self, node: ast.expr, scope: Scope) -> Any:
        """The value of an expression; UNKNOWN if it cannot be determined. Raises Doubt."""
        match node:
            case ast.Constant():
                return node.value
            case ast.Name():
                return scope.find(node.id) if is_defined(scope, node.id) else UNKNOWN
            case ast.NamedExpr():
                value = self.evaluate(node.value, scope)
                self.assign(node.target, value, scope)
                return value
            case ast.List() | ast.Tuple():
                items = [self.evaluate(item, scope) for item in node.elts]
                if any(isinstance(item, ast.Starred) for item in node.elts):
                    return UNKNOWN
                return items if isinstance(node, ast.List) else tuple(items)
            case ast.Dict():
                keys = [self.evaluate(key, scope) if key is not None else UNKNOWN for key in node.keys]
                values = [self.evaluate(value, scope) for value in node.values]
                return dict(zip(keys, values, strict=True)) if is_known(keys) else UNKNOWN
            case ast.ListComp():
                return self._evaluate_list(node, scope)
            case ast.Subscript() | ast.Slice() | ast.Attribute():
                return self._evaluate_part(node, scope)
            case ast.BinOp() | ast.UnaryOp() | ast.Compare():
                return self._evaluate_operation(node, scope)
            case ast.BoolOp():
                return self._evaluate_logic(node, scope)
            case ast.IfExp():
                decided = self.find_truth(self.evaluate(node.test, scope))
                if decided is not None:
                    return self.evaluate(node.body if decided else node.orelse, scope)
                self.forget(node.body, scope)
                self.forget(node.orelse, scope)
                return UNKNOWN
            case ast.Call():
                return self._call(node, scope)
            case ast.Starred() | ast.FormattedValue():
                return self.evaluate(node.value, scope) and UNKNOWN
            case ast.JoinedStr():
                for part in node.values:
                    self.evaluate(part, scope)
                return UNKNOWN
        self.forget(node, scope)
        return UNKNOWN

    def _evaluate_part(self, node: ast.Subscript | ast.Slice | ast.Attribute, scope: Scope) -> Any:
        if isinstance(node, ast.Slice):
            bounds = [
                self.evaluate(part, scope) if part is not None else None
                for part in (node.lower, node.upper, node.step)
            ]
            return slice(*bounds) if is_known(bounds) else UNKNOWN
        held = self.evaluate(node.value, scope)
        if isinstance(node, ast.Attribute):
            return held.has_tip if isinstance(held, Pipette) and node.attr == "has_tip" else UNKNOWN
        key = self.evaluate(node.slice, scope)
        return UNKNOWN if id(held) in self._spoiled else item_of(held, key)

    def _evaluate_operation(self, node: ast.BinOp | ast.UnaryOp | ast.Compare, scope: Scope) -> Any:
        if isinstance(node, ast.BinOp):
            left, right = self.evaluate(node.left, scope), self.evaluate(node.right, scope)
            spoiled = id(left) in self._spoiled or id(right) in self._spoiled
            return UNKNOWN if spoiled else combine(type(node.op), left, right)
        if isinstance(node, ast.UnaryOp):
            held = self.evaluate(node.operand, scope)
            if isinstance(node.op, ast.Not):
                truth = self.find_truth(held)
                return UNKNOWN if truth is None else not truth
            return apply(UNARY[type(node.op)], held) if is_known(held) and type(node.op) in UNARY else UNKNOWN
        sides = [self.evaluate(side, scope) for side in (node.left, *node.comparators)]
        if len(sides) > 2 or not all(map(is_flat, sides)) or any(id(side) in self._spoiled for side in sides):
            return UNKNOWN
        return apply(COMPARISONS[type(node.ops[0])], *sides)

    def _evaluate_logic(self, node: ast.BoolOp, scope: Scope) -> Any:
        """The value of ``a and b`` or ``a or b``. Later parts are evaluated only if needed."""
        value: Any = UNKNOWN
        for number, part in enumerate(node.values):
            value = self.evaluate(part, scope)
            truth = self.find_truth(value)
            if truth is None:
                for later in node.values[number + 1 :]:
                    self.forget(later, scope)
                return UNKNOWN
            if truth is not isinstance(node.op, ast.And):
                return value
        return value

    def _evaluate_list(self, node: ast.ListComp, scope: Scope) -> Any:
        """The list of a comprehension with one loop of known length and no condition; else UNKNOWN."""
        (first, *more) = node.generators
        items = self.list_items(self.evaluate(first.iter, scope))
        if items is None or more or first.ifs:
            self.forget(node, scope)
            return UNKNOWN
        inner, found = Scope(scope), []
        for item in items:
            self.step()
            self.assign(first.target, item, inner)
            found.append(self.evaluate(node.elt, inner))
        return found

    def list_items(self, value: Any) -> Sequence[Any] | None:
        """The items of a loop over this value; None if they are not known."""
        if id(value) in self._spoiled or not isinstance(value, list | tuple | range | dict | str):
            return None
        return value if isinstance(value, range) else list(value)

    def find_truth(self, value: Any) -> bool | None:
        """Whether a value counts as true; None if that is not known."""
        plain = isinstance(value, bool | int | float | str | list | tuple | dict | range) or value is None
        return bool(value) if plain and id(value) not in self._spoiled else None

    # -- calls -------------------------------------------------------------------------------

    def _call(self, node: ast.Call, scope: Scope) -> Any:
        args = [self.evaluate(arg.value if isinstance(arg, ast.Starred) else arg, scope) for arg in node.args]
        named = {key.arg or "**": self.evaluate(key.value, scope) for key in node.keywords}
        spread = "**" in named or any(isinstance(arg, ast.Starred) for arg in node.args)
        if isinstance(node.func, ast.Attribute):
            held = self.evaluate(node.func.value, scope)
            return self._call_method(node.func, held, args, named, spread)
        function = self.evaluate(node.func, scope)
        if isinstance(function, Function):
            return self.enter(function, args, named, spread)
        name = node.func.id if isinstance(node.func, ast.Name) and not is_defined(scope, node.func.id) else ""
        if name and not named and not spread and not any(id(arg) in self._spoiled for arg in args):
            found = call_builtin(name, args)
            if found is not UNKNOWN or name in UNHARMFUL:
                return found
        return self._call_unknown(name or "the called function", [*args, *named.values()])

    def _call_unknown(self, name: str, given: list[Any]) -> Any:
        """UNKNOWN, for a call that cannot be followed. Raises Doubt if its arguments let it take tips."""
        for part in parts_of(given):
            if isinstance(part, Pipette | Protocol):
                raise Doubt(f"line {self.where}: what `{name}` does with a pipette cannot be determined")
            self.spoil(part)
            self.check_takes_no_tips(part)
        return UNKNOWN

    def _call_method(
        self, method: ast.Attribute, held: Any, args: list[Any], named: dict[str, Any], spread: bool
    ) -> Any:
        name = method.attr
        if isinstance(held, Pipette):
            return self._call_pipette(method, held, named, spread)
        if name in TAKES:
            raise Doubt(f"line {method.lineno}: the pipette of `{name}` cannot be determined")
        if isinstance(held, Protocol):
            if name == "load_instrument":
                return Pipette(args[0] if args else named.get("instrument_name", UNKNOWN))
            return UNKNOWN
        if isinstance(held, list | dict) and id(held) not in self._spoiled:
            if name == "append" and isinstance(held, list) and len(args) == 1 and not self.unsure:
                held.append(args[0])
                return None
            if name in ("items", "values", "keys") and isinstance(held, dict):
                return list(getattr(held, name)())
            if name not in ("copy", "index", "count", "get"):
                self.spoil(held)
        return self._call_unknown(name, [*args, *named.values()])

    def _call_pipette(
        self, method: ast.Attribute, pipette: Pipette, named: dict[str, Any], spread: bool
    ) -> Any:
        name = method.attr
        if name in ("drop_tip", "return_tip"):
            pipette.has_tip = UNKNOWN if self.unsure else False
        if name not in TAKES:
            return pipette
        self.counted.add(method)
        how = named.get("new_tip", "once")
        if name == "configure_nozzle_layout" or spread:
            raise Doubt(f"line {method.lineno}: the number of tips of `{name}` cannot be determined")
        if name != "pick_up_tip" and how == "never":
            return pipette
        if name != "pick_up_tip" and how != "once":
            raise Doubt(
                f"line {method.lineno}: the number of tips of `{name}` with new_tip={how!r} cannot be "
                "determined"
            )
        if not isinstance(pipette.name, str):
            raise Doubt(f"line {method.lineno}: the pipette of `{name}` cannot be determined")
        self.tips += count_channels(pipette.name)
        pipette.has_tip = UNKNOWN if self.unsure else name == "pick_up_tip"
        return pipette

    def enter(self, function: Function, args: list[Any], named: dict[str, Any], spread: bool = False) -> Any:
        """Follow a function that the protocol defines; returns its result. Raises Doubt."""
        node, inner = function.node, Scope(function.scope)
        if function.yields:
            return self._call_unknown(node.name, [function, *args, *named.values()])
        given = [arg.arg for arg in (*node.args.posonlyargs, *node.args.args)]
        for name in (*given, *(arg.arg for arg in node.args.kwonlyargs)):
            inner[name] = UNKNOWN if spread else function.defaults.get(name, UNKNOWN)
        inner |= {extra.arg: UNKNOWN for extra in (node.args.vararg, node.args.kwarg) if extra is not None}
        if not spread:
            inner.update(zip(given, args, strict=False))
            inner.update({name: value for name, value in named.items() if name in inner})
        self._depth += 1
        if self._depth > DEEPEST:
            raise Doubt(f"line {node.lineno}: `{node.name}` calls itself")
        before, self.bound = self.bound, ""  # a return leaves only this function
        try:
            self.read_all(node.body, inner)
        except Returned as returned:
            return returned.value
        finally:
            self._depth, self.bound = self._depth - 1, before
        return None

    # -- code that is not followed -----------------------------------------------------------

    def forget(self, node: ast.AST, scope: Scope) -> None:
        """Pass over code that is carried out an unknown number of times. Names that it sets become UNKNOWN,
        and values that it names are spoiled. Raises Doubt if it may take tips."""
        for first in self.find_tip_uses(node):
            raise Doubt(f"line {first.lineno}: only the robot knows how often `{first.attr}` is done")
        for inner in self.walk(node):
            if isinstance(inner, ast.Name) and isinstance(inner.ctx, ast.Store):
                scope.put(inner.id, UNKNOWN)
            elif isinstance(inner, ast.Name):
                found = scope.find(inner.id)
                for part in parts_of(found):
                    self.spoil(part)
                    self.check_takes_no_tips(part)
            elif isinstance(inner, ast.Call):
                self._check_call(inner, scope)

    def _check_call(self, call: ast.Call, scope: Scope) -> None:
        """Raise Doubt if a call that is not followed gives a pipette to a function that the protocol does not
        define."""
        if isinstance(call.func, ast.Name) and isinstance(scope.find(call.func.id), Function):
            return
        for arg in (*call.args, *(key.value for key in call.keywords)):
            for inner in self.walk(arg):
                found = scope.find(inner.id) if isinstance(inner, ast.Name) else None
                if any(isinstance(part, Pipette | Protocol) for part in parts_of(found)):
                    raise Doubt(f"line {call.lineno}: what is done with a pipette there cannot be determined")

    def spoil(self, value: Any) -> None:
        """Mark the content of a list or dict, or whether a pipette has a tip, as unknown from now on."""
        if isinstance(value, list | dict):
            self._spoiled[id(value)] = value
        if isinstance(value, Pipette):
            value.has_tip = UNKNOWN

    def check_takes_no_tips(self, value: Any) -> None:
        """Raise Doubt if the value is a function that takes tips, itself or by functions that it names."""
        open_, seen = [value], set()
        while open_:
            function = open_.pop()
            if not isinstance(function, Function) or function.node in seen:
                continue
            self._looked_at += len(function.names)
            seen.add(function.node)
            if self.find_tip_uses(function.node):
                raise Doubt(
                    f"line {self.where}: how often `{function.node.name}` is done cannot be determined"
                )
            open_ += [part for name in function.names for part in parts_of(function.scope.find(name))]

    @contextmanager
    def suppose(self, why: str) -> Iterator[None]:
        """Inside this context, it is not known whether the code that is read is carried out (``why``)."""
        before = self.unsure, self.bound
        self.unsure, self.bound = self.unsure or why, why
        try:
            yield
        finally:
            self.unsure, self.bound = before


def count_channels(name: str) -> int:
    """The number of tips that a pipette of this name picks up at once."""
    return 96 if "_96" in name else 8 if "_multi" in name or "_8channel" in name else 1


def find_tip_uses(node: ast.AST) -> Iterator[ast.Attribute]:
    """The places in a syntax tree at which tips are taken."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Attribute) and inner.attr in TAKES:
            yield inner


def is_defined(scope: Scope | None, name: str) -> bool:
    """Whether a name has a value in a scope or in one around it."""
    while scope is not None:
        if name in scope:
            return True
        scope = scope.outer
    return False
