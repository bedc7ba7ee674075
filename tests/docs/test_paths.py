"""All paths, modules, classes, settings and commands named in the pages exist."""

import ast
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

import yaml

from hdsp import Motion, Plan, Planner
from hdsp.base.extensions import HEURISTICS, NETWORKS, TERRAIN
from hdsp.robot.schema import keys, robot_schema
from tests import ROOT

PAGES = [
    path
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
    if path.is_file()
]
CONF = sorted((ROOT / "conf").rglob("*.yaml"))
#: Folders under version control, and the packages among them.
FOLDERS = "hdsp|pipeline|benchmarks|conf|docs|tests|examples|reports"
PACKAGES = "hdsp|pipeline|benchmarks|examples|tests"
#: Groups of conf, and sections of a robot file.
GROUPS = sorted(path.name for path in (ROOT / "conf").iterdir() if path.is_dir())
SECTIONS = sorted(yaml.safe_load((ROOT / "hdsp/robot/presets/momaro.yaml").read_text()))
#: Variable names in the pages, and their classes.
OBJECTS = {"plan": Plan, "planner": Planner, "motion": Motion}
#: Results of the pipeline that are not under version control.
MADE = {
    out
    for stage in yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"].values()
    for out in stage.get("outs", [])
    if isinstance(out, str)
}
SUFFIXES = {"md", "yaml", "json", "safetensors", "py", "png", "npz", "bag", "mcap", "csv"}


def texts() -> Iterator[tuple[str, str]]:
    """Name and text for each page, and for the comments in each conf file."""
    for page in PAGES:
        yield page.name, page.read_text()
    for path in CONF:
        yield path.relative_to(ROOT).as_posix(), "\n".join(re.findall(r"#(.*)", path.read_text()))


def found(pattern: str) -> list[tuple[str, str]]:
    """(text name, match) for all matches in all texts, without the full stop at the end of a sentence."""
    matches = {(name, match.rstrip(".")) for name, text in texts() for match in re.findall(pattern, text)}
    assert matches, f"no text has {pattern}"
    return sorted(matches)


def spans(page: Path) -> list[str]:
    """Inline code in a page."""
    return re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL))


def exists(path: str) -> bool:
    """Whether a path leads to a file; a word in capitals or a shell variable matches any name."""
    return path in MADE or any(ROOT.glob(re.sub(r"\$\w+|\b[A-Z]{2,}\b(?!\.md)", "*", path).rstrip("/")))


def resolves(name: str) -> bool:
    if name in (HEURISTICS, NETWORKS, TERRAIN):  # groups of entry points
        return True
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def settings(group: str) -> set[str]:
    """Dotted keys from all files in a conf group, and in the groups within it."""
    keys: set[str] = set()
    folder = ROOT / "conf" / group
    for path in folder.rglob("*.yaml"):
        inner = "".join(f"{part}." for part in path.parent.relative_to(folder).parts)
        keys |= {inner.rstrip("."), *_keys(yaml.safe_load(path.read_text()), inner)}
    return keys


def _keys(values: object, prefix: str) -> set[str]:
    if not isinstance(values, dict):
        return set()
    return {f"{prefix}{key}" for key in values}.union(*(_keys(below, f"{prefix}{k}.") for k, below in values.items()))


def members_of_classes() -> dict[str, set[str]]:
    """Classes in the package, with their methods and annotated attributes."""
    members: dict[str, set[str]] = {}
    for path in (ROOT / "hdsp").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                of_class = members.setdefault(node.name, set())
                for part in node.body:
                    if isinstance(part, ast.FunctionDef):
                        of_class.add(part.name)
                    elif isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
                        of_class.add(part.target.id)
    return members


def test_a_path_leads_to_a_file():
    paths = found(rf"(?<![\w./:-])(?:{FOLDERS})/[\w./*$-]+")
    assert [place for place in paths if not exists(place[1])] == []


def test_a_dotted_name_is_a_module_or_a_name_in_one():
    names = found(rf"(?<![\w./-])(?:{PACKAGES})\.[A-Za-z_][\w.]*\w")
    assert [(page, name) for page, name in names if name.split(".")[-1] not in SUFFIXES and not resolves(name)] == []


def test_classes_and_their_members_exist():
    members = members_of_classes()
    missing = []
    for page in PAGES:
        for span in spans(page):
            if match := re.fullmatch(r"((?:[A-Z]+[a-z]+)+)(?:\.(\w+))?(?:\(.*\))?", span):
                name, member = match.groups()
                if name not in members or (member and member not in members[name]):
                    missing.append((page.name, span))
    assert missing == []


def test_members_of_plans_planners_and_motions_exist():
    missing = []
    for page, name in found(r"(?<![\w./-])(?:plan|planner|motion)\.[a-z_]+(?![\w.])"):
        variable, member = name.split(".")
        kind = OBJECTS[variable]
        known = {*dir(kind), *getattr(kind, "__annotations__", {}), *settings(variable), *SUFFIXES}
        if member not in known:
            missing.append((page, name))
    assert missing == []


def test_settings_exist():
    known = {f"{group}.{key}" for group in GROUPS for key in settings(group)}
    known |= settings("robot") | {key.path for key in keys(robot_schema())}
    missing = []
    for page in PAGES:
        names = set(re.findall(rf"(?<![\w./-])(?:{'|'.join(GROUPS)})\.[a-z_.]+\w(?==)", page.read_text()))
        for span in spans(page):
            names |= set(re.findall(rf"^(?:{'|'.join([*GROUPS, *SECTIONS])})\.[a-z_.]+\w(?=$|[=:])", span))
        for name in sorted(names):
            variable, member = name.split(".", 1)
            own = ".mine." in name or member.split(".")[-1] in SUFFIXES or hasattr(OBJECTS.get(variable), member)
            if name not in known and not own:
                missing.append((page.name, name))
    assert missing == []


def test_the_files_of_conf_that_commands_choose_exist():
    missing = []
    for page, choice in found(rf"(?<![\w.])(?:{'|'.join(GROUPS)})=[\w/,$*]+"):
        group, names = choice.split("=")
        missing += [(page, choice) for name in names.split(",") if not exists(f"conf/{group}/{name}.yaml")]
    assert missing == []


def test_a_link_to_a_heading_leads_to_one():
    missing = []
    for page in PAGES:
        for target, anchor in re.findall(r"\]\((?!http)([^)#]*)#([^)]+)\)", page.read_text()):
            headings = re.findall(r"^#+ (.*)$", (page.parent / target if target else page).read_text(), re.MULTILINE)
            slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
            if anchor not in slugs:
                missing.append((page.name, f"{target}#{anchor}"))
    assert missing == []


def test_the_page_of_benchmarks_lists_each_of_them_once():
    page = (ROOT / "docs" / "benchmarks.md").read_text()
    listed = re.findall(r"`python -m benchmarks\.(\w+)", page)
    folder = ROOT / "benchmarks"
    runnable = {path.stem for path in folder.glob("*.py") if "__main__" in path.read_text()}
    runnable |= {path.parent.name for path in folder.glob("*/__main__.py")}
    assert sorted(listed) == sorted(runnable)
