"""Compares every pinned package with published advisories by pip-audit: ``python tools/audit.py`` (`make audit`).

Status 0: all packages were compared, and none has a known vulnerability. 1: some have. 2: no or not all advisories
could be reached, and the line says so.
"""

import json
import subprocess
import sys
from pathlib import Path

CONSTRAINTS = Path(__file__).resolve().parents[1] / "constraints.txt"


def verdict(report: dict) -> tuple[int, list[str]]:
    """Returns status and lines for a report of pip-audit in JSON."""
    packages = report["dependencies"]
    skipped = [package["name"] for package in packages if "skip_reason" in package]
    lines = [
        f"{package['name']} {package['version']}: {found['id']}, mended in {', '.join(found['fix_versions']) or 'none'}"
        for package in packages
        for found in package.get("vulns", ())
    ]
    compared = len(packages) - len(skipped)
    if lines:
        return 1, [*lines, f"{len(lines)} known vulnerabilities in {compared} packages"]
    if skipped:
        some = ", ".join(skipped[:5])
        return 2, [
            f"not audited: no advisories were reached for {len(skipped)} of {len(packages)} packages ({some} ...)"
        ]
    return 0, [f"no known vulnerability in {compared} packages"]


def main() -> int:
    command = [sys.executable, "-m", "pip_audit", "--requirement", str(CONSTRAINTS), "--no-deps", "--disable-pip"]
    options = ["--format", "json", "--progress-spinner", "off", "--timeout", "15"]
    done = subprocess.run([*command, *options], capture_output=True, text=True)
    try:
        status, lines = verdict(json.loads(done.stdout))
    except (ValueError, KeyError):
        reason = (done.stderr.strip().splitlines() or ["pip-audit ended without a word"])[-1]
        status, lines = 2, [f"not audited, no advisories were reached: {reason[:200]}"]
    print("\n".join(lines))
    return status


if __name__ == "__main__":
    sys.exit(main())
