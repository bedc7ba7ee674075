"""Mutants: one small change at a time inside the functions of a source file.

The changes are the usual ones: comparisons and their bounds, arithmetic and bit operators, ``and`` and ``or``, numbers
one up and one down, truth values, signs, conditions, ``break`` and ``continue``, returned values, and statements that
write into an array, an attribute or a counter or call a function.

Signatures, decorators, annotations, docstrings and messages of errors stay as they are.
"""

import ast
import hashlib
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from types import CodeType
from typing import NamedTuple

from tests import ROOT

_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv, ast.Pow: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitOr,
}  # fmt: skip
_LEFT_ALONE = {"args", "decorator_list", "returns", "annotation", "type_params"}
_Function = ast.FunctionDef
_Put = Callable[[ast.AST], None]


class Mutant(NamedTuple):
    """A change in one function.

    Attributes:
        file: source file, from the root of the checkout.
        function: qualified name.
        line: number of the changed statement's first line.
        change: that line before and after the change.
        number: place among equal changes of the function.
        digest: of the function without the change.
        code: the function with the change.
        source: the file with the change.
    """

    file: str
    function: str
    line: int
    change: str
    number: int
    digest: str
    code: Callable[[], CodeType]
    source: Callable[[], str]

    @property
    def name(self) -> str:
        """Identifies the mutant; holds no line number, so that edits elsewhere leave it."""
        again = f" ({self.number + 1})" if self.number else ""
        return f"{self.file} {self.function}: {self.change}{again}"

    def rank(self, seed: int) -> str:
        """Place in a random order, which edits elsewhere leave as it is."""
        return hashlib.sha256(f"{seed} {self.name}".encode()).hexdigest()


def mutants_of(file: str) -> list[Mutant]:
    """All mutants of a source file."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    found = []
    for name, function in _functions(tree):
        numbers: Counter[str] = Counter()
        digest = hashlib.sha256(ast.unparse(function).encode()).hexdigest()[:16]
        for statement, put, old, new in _changes(function):
            before = _first_line(statement)
            put(new)
            after = _first_line(new if statement is old else statement)
            put(old)
            change = f"{before} -> {after}"
            code, source = partial(_code, file, tree, name, put, old, new), partial(_source, tree, put, old, new)
            found.append(Mutant(file, name, statement.lineno, change, numbers[change], digest, code, source))
            numbers[change] += 1
    return found


def _functions(tree: ast.Module) -> Iterator[tuple[str, _Function]]:
    """Functions and methods with their qualified names."""
    for node in tree.body:
        if isinstance(node, _Function):
            yield node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from ((f"{node.name}.{inner.name}", inner) for inner in node.body if isinstance(inner, _Function))


def _changes(function: _Function) -> Iterator[tuple[ast.stmt, _Put, ast.AST, ast.AST]]:
    """Changed statement, a way to put a node into its place, the node and another one for it."""
    waiting: list[tuple[ast.AST, ast.stmt]] = [(function, function)]
    while waiting:
        parent, statement = waiting.pop()
        for child, put in _children(parent):
            if isinstance(child, ast.Raise | ast.JoinedStr):
                continue
            inside = child if isinstance(child, ast.stmt) else statement
            for new in _others(parent, child):
                yield inside, put, child, new
            waiting.append((child, inside))


def _children(parent: ast.AST) -> Iterator[tuple[ast.AST, _Put]]:
    for field, value in ast.iter_fields(parent):
        if isinstance(parent, _Function) and field in _LEFT_ALONE:
            continue
        if field == "annotation":
            continue
        if isinstance(value, list):
            for i, child in enumerate(value):
                if isinstance(child, ast.AST):
                    yield child, partial(value.__setitem__, i)
        elif isinstance(value, ast.AST):
            yield value, partial(setattr, parent, field)


def _others(parent: ast.AST, child: ast.AST) -> Iterator[ast.AST]:
    """Nodes that take the place of a child, one for each mutant."""
    if type(child) in _OPERATORS:
        yield _OPERATORS[type(child)]()
        return
    if isinstance(child, ast.expr):
        for new in _other_expressions(parent, child):
            yield ast.copy_location(new, child)
    elif isinstance(child, ast.Break | ast.Continue):
        yield ast.copy_location(ast.Continue() if isinstance(child, ast.Break) else ast.Break(), child)
    elif _has_effect(child):
        yield ast.copy_location(ast.Pass(), child)


def _other_expressions(parent: ast.AST, child: ast.expr) -> Iterator[ast.expr]:
    if isinstance(child, ast.Constant):
        if isinstance(child.value, bool):
            if not isinstance(parent, ast.While):  # the same as another condition
                yield ast.Constant(not child.value)
        elif isinstance(child.value, int | float):
            yield from (ast.Constant(child.value + 1), ast.Constant(child.value - 1))
    elif isinstance(child, ast.UnaryOp):
        yield child.operand
    if isinstance(parent, ast.If | ast.While | ast.IfExp) and child is parent.test:
        yield ast.UnaryOp(ast.Not(), child)
    if isinstance(parent, ast.Return) and not isinstance(child, ast.Constant):
        yield ast.Constant(0)


def _has_effect(child: ast.AST) -> bool:
    """Whether a statement calls a function, counts, or writes into an array or an attribute.

    Other assignments give a name its first value: without them, most functions end with an error at once.
    """
    if isinstance(child, ast.Expr):
        return not isinstance(child.value, ast.Constant)
    written = [node for target in getattr(child, "targets", ()) for node in ast.walk(target)]
    return isinstance(child, ast.AugAssign) or any(isinstance(node, ast.Subscript | ast.Attribute) for node in written)


def _first_line(node: ast.AST) -> str:
    """A statement in one line, without the statements inside it."""
    return ast.unparse(node).strip().partition("\n")[0]


def _source(tree: ast.Module, put: _Put, old: ast.AST, new: ast.AST) -> str:
    put(new)
    try:
        return ast.unparse(tree)
    finally:
        put(old)


def _code(file: str, tree: ast.Module, name: str, put: _Put, old: ast.AST, new: ast.AST) -> CodeType:
    put(new)
    try:
        module = compile(ast.fix_missing_locations(tree), file, "exec", dont_inherit=True)
    finally:
        put(old)
    waiting = [module]
    for code in waiting:  # grows during the loop
        if code.co_qualname == name:
            return code
        waiting += [inner for inner in code.co_consts if isinstance(inner, CodeType)]
    raise AssertionError(f"no function {name}")
