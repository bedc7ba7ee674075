"""Writes constraints-hashes.txt: every pin of constraints.txt with the SHA-256 of the file that pip would install.

``python tools/hashes.py`` (`make hashes`) asks pip for a report without installing. The file holds for one platform,
which its first lines name; `pip install --require-hashes --no-deps -r constraints-hashes.txt` uses it.
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


def lock(report: dict) -> str:
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
    system = f"{platform.system()} {platform.machine()}"
    python = ".".join(platform.python_version_tuple()[:2])
    return _HEAD.format(system=system, python=python) + "\n".join(sorted(lines, key=str.lower)) + "\n"


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        options = ["--dry-run", "--ignore-installed", "--no-deps", "--quiet", "--report", str(report)]
        subprocess.run([sys.executable, "-m", "pip", "install", *options, "-r", str(CONSTRAINTS)], check=True)
        HASHES.write_text(lock(json.loads(report.read_text())))
    print(f"{HASHES.name}: {sum('--hash' in line for line in HASHES.read_text().splitlines())} packages")


if __name__ == "__main__":
    main()
