"""Count words in the docstrings of ``hdsp`` that make sentences hard to read, per 1,000 words.

    python tools/docstring_words.py          # a table; exit status 1 where a limit is exceeded
    python tools/docstring_words.py --files  # also the files with the largest shares

Few "of" and "that" mean short sentences; "what" stands for a noun that the sentence lacks.
"""

import argparse
import ast
import re
import sys
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "hdsp"
#: Most occurrences per 1,000 words.
LIMITS = {"what": 1.0, "of": 30.0, "that": 9.0}
#: Files with fewer words have no share worth a look.
FEW = 100


def words_of(path: Path) -> list[str]:
    """Lower-case words of the docstrings of a file, in modules, classes and functions."""
    words: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            words += re.findall(r"[a-z']+", (ast.get_docstring(node) or "").lower())
    return words


def shares(words: list[str]) -> dict[str, float]:
    """Occurrences per 1,000 words of each word with a limit."""
    counts = Counter(words)
    return {word: 1000 * counts[word] / max(len(words), 1) for word in LIMITS}


def main(arguments: list[str] | None = None) -> int:
    """Print the shares; returns 1 where one exceeds its limit, else 0."""
    parser = argparse.ArgumentParser(description="words per 1,000 words of docstrings")
    parser.add_argument("--files", action="store_true", help="also the ten files with the largest shares")
    parser.add_argument("package", nargs="?", type=Path, default=PACKAGE)
    chosen = parser.parse_args(arguments)
    files = {path: words_of(path) for path in sorted(chosen.package.rglob("*.py"))}
    total = shares([word for words in files.values() for word in words])
    for word, limit in LIMITS.items():
        verdict = "above the limit" if total[word] > limit else "within the limit"
        print(f"{word:5} {total[word]:5.1f} per 1,000 words, {verdict} of {limit:g}")
    print(f"{sum(map(len, files.values()))} words in {len(files)} files")
    if chosen.files:
        worst = {path: max(s / LIMITS[w] for w, s in shares(words).items()) for path, words in files.items()}
        large = [path for path in sorted(worst, key=lambda path: -worst[path]) if len(files[path]) >= FEW]
        for path in large[:10]:
            found = ", ".join(f"{word} {share:.1f}" for word, share in shares(files[path]).items())
            print(f"{path.relative_to(chosen.package)}: {found}")
    return int(any(total[word] > limit for word, limit in LIMITS.items()))


if __name__ == "__main__":
    sys.exit(main())
