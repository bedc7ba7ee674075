"""Parser of the command line: short errors that name what is allowed, help texts with groups and examples."""

from __future__ import annotations

import argparse
import difflib
import re
import shutil
from collections.abc import Sequence
from typing import Any, NoReturn

import shtab

_WIDEST = 100
#: Words with a minus that are numbers; argparse itself knows no exponents and takes them for options.
_NEGATIVE = re.compile(r"-(?:(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:e[-+]?\d+)?|inf(?:inity)?|nan)$", re.IGNORECASE)


class HelpText(argparse.HelpFormatter):
    """Fills descriptions; keeps the lines of examples. At most 100 columns wide."""

    def __init__(self, prog: str):
        width = min(shutil.get_terminal_size().columns, _WIDEST) - 2
        super().__init__(prog, max_help_position=26, width=width)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith("examples:") else super()._fill_text(text, width, indent)


class CommandParser(argparse.ArgumentParser):
    """Parser of `hdsp` or of one of its commands."""

    def __init__(self, **options: Any):
        super().__init__(**{"formatter_class": HelpText, **options})
        for kind, name in ((float, "number"), (int, "whole number")):
            self.register("type", kind, _converter(kind, name))
        self._negative_number_matcher = _NEGATIVE

    def error(self, message: str) -> NoReturn:
        """Ends with status 2; only the short usage of `hdsp` itself comes with the error."""
        if self._subparsers is not None:
            super().error(message)
        self.exit(2, f"error: {message}; see {self.prog} --help\n")

    def refuse_unknown(self, words: Sequence[str]) -> NoReturn:
        """Ends with an error about words that the command does not know."""
        allowed = [name for action in self._actions for name in action.option_strings if name.startswith("--")]
        unknown = words[0].partition("=")[0]
        if not unknown.startswith("-"):
            self.error(f"unexpected argument {words[0]!r}")
        meant = difflib.get_close_matches(unknown, allowed, n=1)
        hint = f"did you mean {meant[0]}" if meant else f"allowed are {', '.join(allowed)}"
        self.error(f"unknown option {unknown}; {hint}")


def _converter(kind: type, name: str):
    def convert(text: str):
        try:
            return kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is no {name}") from None

    return convert


def option_group(parser: argparse.ArgumentParser, title: str) -> Any:
    """Returns the group of options with this title, a new one if there is none."""
    for group in parser._action_groups:
        if group.title == title:
            return group
    return parser.add_argument_group(title)


def takes_file(action: argparse.Action) -> argparse.Action:
    """Lets the shell complete file names for an argument."""
    action.complete = shtab.FILE  # type: ignore[attr-defined]
    return action


def takes_words(action: argparse.Action, name: str, words: Sequence[str]) -> argparse.Action:
    """Lets the shell complete some words, and files, for an argument.

    Args:
        action: the argument.
        name: its name in the completion script.
        words: the words.
    """
    function, listed = f"_hdsp_{name}", " ".join(words)
    action.complete = {  # type: ignore[attr-defined]
        "bash": function,
        "zsh": function,
        "tcsh": "f",
        "preamble": {
            "bash": f'{function}() {{ compgen -W "{listed}" -- "$1"; compgen -f -- "$1"; }}',
            "zsh": f'{function}() {{ _alternative "{name}s:{name}:({listed})" "files:file:_files" }}',
        },
    }
    return action


def add_robot(parser: Any, default: str | None = "momaro") -> None:
    """Adds the option --robot."""
    from hdsp.robot.robot import Robot

    presets = Robot.presets()
    text = f"{', '.join(presets)}, or a YAML file" + (f" (default: {default})" if default else "")
    takes_words(parser.add_argument("--robot", default=default, help=text), "robot", presets)


#: Heuristics by name; `learned` may also have a folder.
HEURISTICS = ("geometric", "grid", "manual", "learned")


def add_heuristic(parser: Any) -> None:
    """Adds the option --heuristic."""
    action = parser.add_argument(
        "--heuristic",
        default="manual",
        help=f"{', '.join(HEURISTICS)} (the abstraction that comes with the package) or learned:FOLDER "
        "(default: manual)",
    )
    takes_words(action, "heuristic", [*HEURISTICS, "learned:"])


def add_json(parser: Any) -> None:
    """Adds the option --json."""
    parser.add_argument("--json", action="store_true", help="print one JSON document, for scripts")
