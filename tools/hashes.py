"""Writes constraints-hashes.txt: every pin of constraints.txt with the SHA-256 of the file that pip would install.

``python tools/hashes.py`` (`make hashes`) asks pip for a report on pins without a hash so far, and installs nothing.
The file holds for one platform, which its first line names; `pip install --require-hashes --no-deps -r
constraints-hashes.txt` uses it.
"""

import json
import platform
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS, HASHES = ROOT / "constraints.txt", ROOT / "constraints-hashes.txt"
#: Local version in the name of a wheel that is not on the package index.
_BUILD = re.compile(r"(?:\+|%2B)(\w+)-")
_HEAD = """\
# Written by `make hashes` from constraints.txt: pins with the SHA-256 of their files for {system}, Python {python}.
# pip install --require-hashes --no-deps -r constraints-hashes.txt
"""


def pins(text: str) -> dict[tuple[str, str], str]:
    """Lines of a file with pins, by normalised name and version without a local part."""
    found = {}
    for line in text.splitlines():
        if match := re.match(r"([\w.-]+)==([\w.]+)", line):
            found[re.sub(r"[-_.]+", "-", match[1]).lower(), match[2]] = line
    return found


def lines_of(report: dict) -> list[str]:
    """Returns the lines for pip's installation report.

    Raises:
        SystemExit: the index names no hash for a package.
    """
    lines, without = [], []
    for part in report["install"]:
        name, version = part["metadata"]["name"], part["metadata"]["version"]
        digest = part["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256")
        if digest is None:
            without.append(name)
        build = _BUILD.search(part["download_info"].get("url", ""))
        where = f"  # {build[1]} build, from https://download.pytorch.org/whl/{build[1]}" if build else ""
        lines.append(f"{name}=={version} --hash=sha256:{digest}{where}")
    if without:
        raise SystemExit(f"no hash for {', '.join(without[:10])}; {HASHES.name} is not written")
    return lines


def asked(wanted: list[str]) -> dict:
    """Returns pip's report on an installation of these pins."""
    with tempfile.TemporaryDirectory() as folder:
        report, pinned = Path(folder) / "report.json", Path(folder) / "pins.txt"
        pinned.write_text("\n".join(wanted))
        options = ["--dry-run", "--ignore-installed", "--no-deps", "--quiet", "--report", str(report)]
        subprocess.run([sys.executable, "-m", "pip", "install", *options, "-r", str(pinned)], check=True)
        return json.loads(report.read_text())


def main() -> None:
    wanted = pins(CONSTRAINTS.read_text())
    known = {pin: line for pin, line in pins(HASHES.read_text() if HASHES.is_file() else "").items() if pin in wanted}
    missing = [line for pin, line in wanted.items() if pin not in known]
    lines = [*known.values(), *(lines_of(asked(missing)) if missing else [])]
    system = f"{platform.system()} {platform.machine()}"
    head = _HEAD.format(system=system, python=".".join(platform.python_version_tuple()[:2]))
    HASHES.write_text(head + "\n".join(sorted(lines, key=str.lower)) + "\n")
    print(f"{HASHES.name}: {len(lines)} packages, {len(missing)} of them new")


if __name__ == "__main__":
    main()
