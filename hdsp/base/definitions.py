"""Definitions in a module's source: statements that define a name, with all names they refer to.

This module imports no analysed code. A definition's normal form keeps the code that decides results, without comments,
docstrings, layout, type annotations, imports, error messages and ``__repr__``.
"""

import ast
import copy
import symtable
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property

#: Module and a name in it; None = the module itself.
Target = tuple[str, str | None]
#: Name with its attributes: ``("lattice", "RESOLUTION")``; the name is empty for attributes of other values.
Chain = tuple[str, ...]

#: Decorators without effects beyond their function or class.
PURE_DECORATORS = {
    "abstractmethod", "cache", "cached_property", "checked", "classmethod", "contextmanager", "dataclass", "final",
    "intrinsic", "lru_cache", "njit", "override", "property", "runtime_checkable", "setter", "staticmethod",
    "total_ordering", "wraps",
}  # fmt: skip
#: Methods that show a value to a person; no result depends on their text.
SHOWING = {"__repr__"}
#: Base classes whose code only calls methods with double underscores.
PASSIVE_BASES = {"ABC", "Enum", "Exception", "Generic", "IntEnum", "NamedTuple", "Protocol", "ValueError", "object"}


@dataclass(eq=False)
class Definition:
    """Statements in a module that define one name.

    Attributes:
        module: dotted module name.
        package: dotted name of the package for relative imports.
        name: defined name; ``Class.method`` for a method; empty for a statement executed with its module.
        node: statement; a class without its methods.
        methods: a class's methods, by name.
    """

    module: str
    package: str
    name: str
    node: ast.stmt
    methods: dict[str, list["Definition"]] = field(default_factory=dict)

    @cached_property
    def normal(self) -> ast.stmt:
        """Statement in normal form, which replaces the original statement."""
        _ = self.imports, self.typed  # the normal form lacks imports and annotations
        self.node = _normal(self.node)
        return self.node

    @cached_property
    def text(self) -> str:
        """Normal form as text, equal in all Python versions; a method's text begins with its class."""
        return f"{self.name.rpartition('.')[0]}:{_text(self.normal)}"

    @cached_property
    def imports(self) -> dict[str, Target]:
        """Names bound by import statements inside the definition."""
        return dict(_imports(self.node, self.package))

    @cached_property
    def loads(self) -> list[str]:
        """Modules imported by a literal name: ``import_module("hdsp.viz")``."""
        calls = [node for node in ast.walk(self.normal) if isinstance(node, ast.Call) and node.args]
        named = [call.args[0] for call in calls if _last_name(call.func) in ("import_module", "__import__")]
        return [node.value for node in named if isinstance(node, ast.Constant) and isinstance(node.value, str)]

    @cached_property
    def chains(self) -> list[Chain]:
        """All names in the code, with their attributes."""
        return _chains(self.normal)

    @cached_property
    def taken(self) -> frozenset[str]:
        """Names read from the module or from an inner import."""
        table = symtable.symtable(ast.unparse(self.normal), self.module, "exec")
        names = {symbol.get_name() for symbol in table.get_symbols() if symbol.is_referenced()} | self.imports.keys()
        for inner in _inner_scopes(table):
            names |= {symbol.get_name() for symbol in inner.get_symbols() if symbol.is_global()}
        return frozenset(names)

    @cached_property
    def typed(self) -> list[Chain]:
        """Like ``chains``, for annotations, because an instance of an annotated type may come from anywhere."""
        return [chain for annotation in _annotations(self.node) for chain in _chains(annotation)]

    @cached_property
    def words(self) -> frozenset[str]:
        """Strings in the code, which ``getattr`` could receive."""
        nodes = ast.walk(self.normal)
        return frozenset(n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str))

    @property
    def bases(self) -> list[Chain] | None:
        """Base classes that may call the class's methods; None if the source does not name them."""
        if not isinstance(self.node, ast.ClassDef):
            return []
        plain = [base.value if isinstance(base, ast.Subscript) else base for base in self.node.bases]
        active = [chain for base in plain if _last_name(base) not in PASSIVE_BASES for chain in _chains(base)[:1]]
        return None if self.node.keywords or not all(chain[0] for chain in active) else active

    @property
    def is_called_by_others(self) -> bool:
        """Whether other code can call a method without mentioning its name."""
        name = self.name.rpartition(".")[2]
        return (name.startswith("__") and name.endswith("__")) or not _is_pure(self.node)


@dataclass
class Module:
    """A module's definitions.

    Attributes:
        name: dotted name.
        is_package: whether the source is an ``__init__.py``.
        definitions: by name, in source order; statements executed with the module under ``""``.
        bindings: names bound by import statements, including ``if TYPE_CHECKING``.
        imported: all run-time imports.
    """

    name: str
    is_package: bool
    definitions: dict[str, list[Definition]] = field(default_factory=dict)
    bindings: dict[str, Target] = field(default_factory=dict)
    imported: list[Target] = field(default_factory=list)

    @staticmethod
    @cache
    def parse(name: str, source: str, is_package: bool) -> "Module":
        """Parses a source; fingerprints share the result."""
        module, package = Module(name, is_package), name if is_package else name.rpartition(".")[0]
        tree = ast.parse(source)
        defined = {name for statement in tree.body for name in _defined(statement)}
        for statement in tree.body:
            if not isinstance(statement, _SCOPES):
                found = dict(_imports(statement, package))
                module.bindings |= found
                if not _is_test_of(statement, "TYPE_CHECKING"):
                    module.imported += found.values()
            if _says_nothing(statement):
                continue
            names = sorted(_defined(statement) or _belongs_to(statement) & defined)
            definition = Definition(name, package, names[0] if names else "", statement)
            if isinstance(statement, ast.ClassDef):
                _split_methods(definition, statement)
            for key in [*names, *([""] if not names or _has_effect(statement) else [])]:
                module.definitions.setdefault(key, []).append(definition)
        return module

    def all(self) -> Iterator[Definition]:
        """Yields every definition, including methods."""
        for definitions in self.definitions.values():
            for definition in definitions:
                yield definition
                for methods in definition.methods.values():
                    yield from methods


_SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def _split_methods(definition: Definition, node: ast.ClassDef) -> None:
    """Separates a class's methods from the class."""
    rest = copy.copy(node)
    rest.body = [statement for statement in node.body if not isinstance(statement, _FUNCTIONS)]
    definition.node = rest
    for method in node.body:
        if isinstance(method, _FUNCTIONS) and method.name not in SHOWING:
            own = Definition(definition.module, definition.package, f"{node.name}.{method.name}", method)
            definition.methods.setdefault(method.name, []).append(own)


def _defined(statement: ast.stmt) -> set[str]:
    """Names defined by a module statement, except imports."""
    if isinstance(statement, _SCOPES):
        return {statement.name}
    inside = list(_same_scope(statement))
    names = {node.id for node in inside if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return names | {node.name for node in inside if isinstance(node, _SCOPES)}


def _same_scope(node: ast.AST) -> Iterator[ast.AST]:
    """The node and all nodes below it in the same scope; functions and classes without their bodies."""
    yield node
    if not isinstance(node, (*_SCOPES, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)):
        for child in ast.iter_child_nodes(node):
            yield from _same_scope(child)


def _belongs_to(statement: ast.stmt) -> set[str]:
    """Name whose value is changed by a statement without own names: ``TABLE[0] = 1``, ``TABLE.sort()``."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
        changed: list[ast.expr] = [statement.value.func]
    elif isinstance(statement, ast.Assign):
        changed = statement.targets
    elif isinstance(statement, ast.AugAssign | ast.AnnAssign):
        changed = [statement.target]
    else:
        return set()
    parts = [node for node in changed if isinstance(node, ast.Attribute | ast.Subscript)]
    return {chain[0] for node in parts for chain in _chains(node)[:1]}


def _has_effect(statement: ast.stmt) -> bool:
    """Whether a statement with defined names can have further effects when it runs."""
    if isinstance(statement, _SCOPES):
        return not _is_pure(statement)
    return not isinstance(statement, ast.Assign | ast.AnnAssign | ast.AugAssign | ast.Expr)


def _is_pure(statement: ast.stmt) -> bool:
    return all(_last_name(decorator) in PURE_DECORATORS for decorator in getattr(statement, "decorator_list", []))


def _says_nothing(statement: ast.stmt) -> bool:
    """Whether a module statement has no influence on results of other code in the module."""
    if isinstance(statement, ast.Import | ast.ImportFrom | ast.Pass) or _is_words(statement):
        return True
    return _defined(statement) == {"__all__"} or any(_is_test_of(statement, n) for n in ("TYPE_CHECKING", "__name__"))


def _is_words(statement: ast.AST) -> bool:
    """Whether a statement is a string, such as a docstring."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _is_test_of(statement: ast.AST, name: str) -> bool:
    """Whether a statement is ``if NAME`` or ``if NAME == ...``."""
    if not isinstance(statement, ast.If):
        return False
    test = statement.test.left if isinstance(statement.test, ast.Compare) else statement.test
    return _last_name(test) == name


def _last_name(node: ast.AST) -> str:
    """``c`` in ``a.b.c`` or ``a.b.c(...)``."""
    if isinstance(node, ast.Call):
        return _last_name(node.func)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _imports(node: ast.AST, package: str) -> Iterator[tuple[str, Target]]:
    """Yields (bound name, target) for import statements below a node."""
    for statement in ast.walk(node):
        if isinstance(statement, ast.Import):
            for alias in statement.names:
                first = alias.name.split(".")[0]
                yield (alias.asname, (alias.name, None)) if alias.asname else (first, (first, None))
                yield alias.name, (alias.name, None)  # loaded in any case; code has no names with dots
        elif isinstance(statement, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - statement.level + 1] if statement.level else []
            source = ".".join([*above, *([statement.module] if statement.module else [])])
            for alias in statement.names:
                yield alias.asname or (f"*{source}" if alias.name == "*" else alias.name), (source, alias.name)


def _inner_scopes(table: symtable.SymbolTable) -> Iterator[symtable.SymbolTable]:
    for inner in table.get_children():
        yield inner
        yield from _inner_scopes(inner)


def _chains(node: ast.AST) -> list[Chain]:
    """All names below a node, each with its attributes; attributes of other values have an empty name."""
    attributes: list[str] = []
    root = node
    while isinstance(root, ast.Attribute):
        attributes.insert(0, root.attr)
        root = root.value
    if isinstance(root, ast.Name):
        return [(root.id, *attributes)]
    inner = [chain for child in ast.iter_child_nodes(root) for chain in _chains(child)]
    return [("", *attributes), *inner] if attributes else inner


def _annotations(node: ast.AST) -> Iterator[ast.AST]:
    """Annotations below a node; quoted ones are parsed as code."""
    for inner in ast.walk(node):
        for annotation in (getattr(inner, "annotation", None), getattr(inner, "returns", None)):
            if annotation is None:
                continue
            yield annotation
            for part in ast.walk(annotation):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    try:
                        yield ast.parse(part.value, mode="eval")
                    except SyntaxError:
                        continue  # a word of a Literal


class _Normaliser(ast.NodeTransformer):
    """Removes all parts without influence on results."""

    _in_class = False

    def generic_visit(self, node: ast.AST) -> ast.AST:
        outer, self._in_class = self._in_class, isinstance(node, ast.ClassDef)
        node = super().generic_visit(node)
        self._in_class = outer
        if getattr(node, "body", None) == []:
            node.body = [ast.Pass()]  # type: ignore[attr-defined]
        for name in ("annotation", "returns", "type_comment"):
            if hasattr(node, name) and not isinstance(node, ast.AnnAssign):
                setattr(node, name, None)
        return node

    def visit_Import(self, node: ast.Import) -> None:
        return None

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        return None

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return None if _is_words(node) else self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.AST]:
        if _is_test_of(node, "TYPE_CHECKING"):
            return [kept for statement in node.orelse if (kept := self.visit(statement)) is not None]
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        if self._in_class:  # only an annotated assignment is a dataclass or tuple field
            node.annotation = ast.Constant(...)
            return self.generic_visit(node)
        if node.value is None:
            return None
        return ast.copy_location(ast.Assign([self.visit(node.target)], self.visit(node.value)), node)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        if node.exc is not None:
            node.exc = _Wordless().visit(node.exc)
        return self.generic_visit(node)

    def visit_Assert(self, node: ast.Assert) -> ast.AST:
        node.msg = None
        return self.generic_visit(node)


class _Wordless(ast.NodeTransformer):
    """Empties strings only, because code that catches the error may read its other arguments."""

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        return ast.Constant("") if isinstance(node.value, str) else node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return ast.Constant("")


def _normal(node: ast.stmt) -> ast.stmt:
    changed = _Normaliser().visit(node)
    return ast.fix_missing_locations(changed if isinstance(changed, ast.stmt) else ast.Pass())


def _text(node: object) -> str:
    """Converts syntax to text; `ast.dump` and `ast.unparse` differ between Python versions."""
    if isinstance(node, ast.AST):
        names = [name for name in node._fields if name not in ("ctx", "kind", "type_params")]
        parts = [(name, getattr(node, name, None)) for name in names]
        return f"{type(node).__name__}({','.join(f'{n}={_text(v)}' for n, v in parts if v is not None and v != [])})"
    if isinstance(node, list):
        return f"[{','.join(map(_text, node))}]"
    return repr(node)
