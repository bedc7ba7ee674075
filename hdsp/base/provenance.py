"""Code fingerprints, so that results from other code do not count as valid.

A function's fingerprint covers its body and all project definitions it reaches: names in its body, names in their
bodies, and so on. A method counts if its class is reached and its name is mentioned. The fingerprint ignores module
names, positions in files, imports, docstrings, comments, layout, type annotations, error messages and ``__repr__``
(`hdsp.base.definitions`), and all code out of reach. Moved code keeps its fingerprint. Modules under `EXEMPT` are left
out.

Limit: names built at run time are invisible, for example in `importlib.import_module(name)`. A caller with such imports
has to pass the modules as entries.
"""

import hashlib
import re
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hdsp.base.definitions import Chain, Definition, Module

PACKAGE = __name__.partition(".")[0]
#: Folder with the packages.
ROOT = Path(__file__).resolve().parents[2]

#: Modules without influence on results, and the reason. A name includes all modules below it.
EXEMPT = {
    "hdsp.base.definitions": "decides which results are still valid, not their values",
    "hdsp.base.downloads": "fetches files by their checksums",
    "hdsp.base.extensions": "finds code of other packages, which has a fingerprint of its own",
    "hdsp.base.errors": "classes of errors, which end a computation",
    "hdsp.base.files": "reads and writes whole files",
    "hdsp.base.kernel_cache": "decides when a kernel is compiled, not its code",
    "hdsp.base.messages": "words for people",
    "hdsp.base.notebook": "shows values to people",
    "hdsp.base.provenance": "decides which results are still valid, not their values",
    "hdsp.base.quiet": "hides warnings from people",
    "hdsp.base.scalars": "reads numbers as users give them",
    "hdsp.base.settings": "checks settings; their checked values are part of each hash",
    "hdsp.base.short_repr": "shows values to people",
    "hdsp.base.storage": "moves bytes to and from folders and URLs",
    "hdsp.base.yaml_files": "reads settings; their checked values are part of each hash",
    "hdsp.base.workers": "decides which process works; a map is a function of its number",
    "hdsp.labels.run.cluster": "decides which process works; a map is a function of its number",
    "hdsp.labels.run.label_store": "finds valid shards; a label is a function of its map",
    "hdsp.labels.run.progress": "shows progress",
    "hdsp.labels.shard_index": "names shards and lists them",
    "hdsp.learning.hub": "moves files of abstractions to and from the hub",
    "hdsp.learning.hub_card": "describes an abstraction to people",
    "hdsp.learning.onnx_export": "writes a trained network in another format",
    "hdsp.robot.motion_limits": "limits of motions; labels have no times",
    "hdsp.robot.physics": "masses and motors of a simulation; labels have none",
    "hdsp.terrain.map_formats": "formats of height maps; a map has the same heights in each",
    "hdsp.viz": "draws results",
    "pipeline.config": "composes settings; their values are parameters of each stage",
    "pipeline.config_types": "checks settings; their values are parameters of each stage",
    "pipeline.label_places": "names labels by their hash, on which later stages depend",
    "pipeline.command_line": "reads words of a command; settings are parameters of each stage",
    "pipeline.html_report": "shows results on a page",
    "pipeline.folders": "names places of files",
    "pipeline.run_logger": "records results in MLflow",
    "pipeline.search": "runs a stage several times",
    "pipeline.served_model": "records results in MLflow",
    "pipeline.sweeps": "runs a stage several times",
    "pipeline.tracking": "records results in MLflow",
}

#: Function, class, or its name ``package.module:name``; the whole module without ``:name``.
Entry = str | Callable[..., Any]


def code_fingerprint(*entries: Entry, root: Path = ROOT) -> str:
    """Returns the hex digest of all code that ``entries`` reach.

    Args:
        entries: start of the search.
        root: folder with the packages; another folder for a copy of them.

    Raises:
        LookupError: an entry's name has no definition.
    """
    names = _names(entries)
    return _running_code(names) if root == ROOT else _digest(_Reach(root, names))


@cache
def _running_code(names: tuple[str, ...]) -> str:
    """Fingerprint of this process's code, independent of later file edits."""
    return _digest(_Reach(ROOT, names))


def reached_code(*entries: Entry, root: Path = ROOT) -> dict[str, list[str]]:
    """Returns the names of all definitions in a fingerprint, by module; arguments as in `code_fingerprint`."""
    names: dict[str, list[str]] = {}
    for definition in _Reach(root, _names(entries)).reached:
        names.setdefault(definition.module, []).append(definition.name)
    return {module: sorted(names[module]) for module in sorted(names)}


def _names(entries: tuple[Entry, ...]) -> tuple[str, ...]:
    return tuple(entry if isinstance(entry, str) else f"{entry.__module__}:{entry.__qualname__}" for entry in entries)


class _Reach:
    """Definitions in reach of the entries.

    Attributes:
        reached: for each definition, the definitions behind its names, by name.
    """

    def __init__(self, root: Path, names: tuple[str, ...]):
        self._root, self._packages = root, {PACKAGE, *(re.split("[.:]", name)[0] for name in names)}
        self._modules: dict[str, Module | None] = {}
        self._run: set[str] = set()
        self._mentioned: set[str] = set()
        self._classes: list[Definition] = []
        self._waiting: list[Definition] = []
        self.reached: dict[Definition, dict[str, list[Definition]]] = {}
        for name in names:
            self._enter(name)
        while self._waiting:
            self._follow(self._waiting.pop())
        for definition in self._classes:
            for name, methods in definition.methods.items():
                if found := [method for method in methods if method in self.reached]:
                    self.reached[definition][f".{name}"] = found

    def _enter(self, entry: str) -> None:
        module, _, name = entry.partition(":")
        owner, _, method = name.partition(".")
        found = self._find(module, owner) if owner else self._module(module)
        definitions = self._definitions(found)
        if method:
            definitions += [own for definition in definitions for own in definition.methods.get(method, [])]
        if not definitions or (method and len(definitions) < 2):
            raise LookupError(f"no code of the name {entry}")
        self._add(definitions)

    def _add(self, definitions: list[Definition]) -> None:
        for definition in definitions:
            if definition not in self.reached:
                self.reached[definition] = {}
                self._waiting.append(definition)

    def _follow(self, definition: Definition) -> None:
        self._run_module(definition.module)
        mentioned = set(definition.words)
        for chain in definition.chains:
            if chain[0] not in definition.taken:
                mentioned.update(chain[1:])  # attributes of a variable
                continue
            name, found, attributes = self._named(definition, chain)
            mentioned.update(attributes)
            self._refer(definition, name, found)
        for module in definition.loads:
            self._refer(definition, f"{module}.*", self._definitions(self._module(module)))
        for chain in definition.typed:
            self._add(self._named(definition, chain)[1])
        for target in definition.imports.values():
            self._run_module(*target)
        if definition.methods:
            self._classes.append(definition)
            is_open = self._is_open(definition)
            for method in [method for methods in definition.methods.values() for method in methods]:
                if is_open or method.is_called_by_others or method.name.rpartition(".")[2] in self._mentioned:
                    self._add([method])
        for name in mentioned - self._mentioned:
            self._mentioned.add(name)
            for owner in self._classes:
                self._add(owner.methods.get(name, []))

    def _refer(self, definition: Definition, name: str, found: list[Definition]) -> None:
        if found:
            self.reached[definition][name] = found
            self._add(found)

    def _named(self, definition: Definition, chain: Chain) -> tuple[str, list[Definition], Chain]:
        """Resolves a chain: the resolved part, its definitions, and further attributes, which may be methods."""
        found = self._find(*definition.imports.get(chain[0], (definition.module, chain[0])))
        length = 1
        while isinstance(found, Module) and length < len(chain):
            found, length = self._find(found.name, chain[length]), length + 1
        definitions, attributes = self._definitions(found), chain[length:]
        if attributes and len(definitions) == 1 and (methods := definitions[0].methods.get(attributes[0])):
            definitions, attributes = [*definitions, *methods], attributes[1:]  # methods of this class alone
        if not definitions and self._is_foreign(definition, chain[0]):
            attributes = ()
        name = ".".join(chain[: len(chain) - len(attributes)])
        return f"{name}.*" if isinstance(found, Module) else name, definitions, attributes

    def _is_foreign(self, definition: Definition, name: str) -> bool:
        """Whether a name is imported from another project; its attributes are no definitions of this project."""
        source = self._module(definition.module)
        target = definition.imports.get(name) or (source.bindings.get(name) if source else None)
        return target is not None and target[0].partition(".")[0] not in self._packages

    def _find(self, module: str, name: str | None) -> "list[Definition] | Module | None":
        """Resolves a name in a module, through all modules that re-export it."""
        seen: set[tuple[str, str | None]] = set()
        while name is not None:
            source = self._module(module)
            if source is None:
                return None
            if name in source.definitions:
                return source.definitions[name]
            if name not in source.bindings or (module, name) in seen:  # a package can pass on its own modules
                for star in [target for bound, target in source.bindings.items() if bound.startswith("*")]:
                    if (found := self._find(star[0], name)) is not None:
                        return found
                return self._module(f"{module}.{name}") if source.is_package else None
            seen.add((module, name))
            module, name = source.bindings[name]
        return self._module(module)

    def _definitions(self, found: "list[Definition] | Module | None") -> list[Definition]:
        """Definitions behind a name; all definitions in a module, and for a package also its re-exported ones."""
        if not isinstance(found, Module):
            return list(found or [])
        passed = found.bindings if found.is_package else {}
        return [
            *found.all(),
            *(d for t in passed.values() if isinstance(own := self._find(*t), list) for d in own),
        ]

    def _run_module(self, module: str, name: str | None = None) -> None:
        """Adds all statements that run when a name is imported. Packages only re-export names (checked by a test)."""
        found = self._find(module, name)
        modules = {d.module for d in found} if isinstance(found, list) else {found.name} if found else set()
        for own in modules - self._run:
            self._run.add(own)
            source = self._module(own)
            if source is not None:
                self._add(source.definitions.get("", []))
                for target in source.imported if not source.is_package or source.definitions else []:
                    self._run_module(*target)

    def _is_open(self, definition: Definition) -> bool:
        """Whether a class has a base from outside the project, whose code may call the class's methods."""
        bases = definition.bases
        if bases is None:
            return True
        for chain in bases:
            owners = self._named(definition, chain)[1]
            if not owners or any(self._is_open(owner) for owner in owners if owner is not definition):
                return True
        return False

    def _module(self, name: str) -> Module | None:
        """Returns a project module; None if it is exempt or does not exist."""
        if name not in self._modules:
            self._modules[name] = self._read(name)
        return self._modules[name]

    def _read(self, name: str) -> Module | None:
        if name.partition(".")[0] not in self._packages or is_exempt(name):
            return None
        place = _folder(self._root, name.partition(".")[0]).joinpath(*name.split("."))
        for path in (place / "__init__.py", place.with_suffix(".py")):
            if path.is_file():
                return Module.parse(name, path.read_text(encoding="utf-8"), path.stem == "__init__")
        return None


@cache
def is_exempt(module: str) -> bool:
    """Whether a module or one of its parent packages is under `EXEMPT`."""
    module = module.removeprefix("hdsp_")  # an installed pipeline is hdsp_pipeline
    return any(module == name or module.startswith(f"{name}.") for name in EXEMPT)


def _folder(root: Path, package: str) -> Path:
    """Folder that holds a package: the root, or for another project's package its own place."""
    if root.joinpath(package).is_dir():
        return root
    spec = find_spec(package)
    if spec is None or (spec.origin is None and not spec.submodule_search_locations):
        return root
    place = Path(next(iter(spec.submodule_search_locations or ()), spec.origin or ""))
    return place.parent


def _digest(reach: _Reach) -> str:
    """Hash over all definitions and their references.

    Two definitions with equal text may refer to different definitions, for example to constants with the same name in
    two modules. Each round therefore adds the hashes of all referenced definitions to a definition's hash, until a
    round separates no further definitions.
    """
    hashes = {definition: _hash(definition.text) for definition in reach.reached}
    while True:
        finer: dict[Definition, str] = {}
        for definition, references in reach.reached.items():
            parts = [(name, [hashes[other] for other in found]) for name, found in sorted(references.items())]
            # Order matters among definitions with one name, but not within a whole module.
            lines = [f"{name} {sorted(found) if name.endswith('*') else found}" for name, found in parts]
            finer[definition] = _hash(definition.text, *lines)
        if len(set(finer.values())) == len(set(hashes.values())):
            return _hash(*sorted(set(finer.values())))
        hashes = finer


def _hash(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
