"""The command `hdsp completion`: a script with which a shell completes commands, options, files and names."""

from __future__ import annotations

import argparse

import shtab

_SHELLS = ("bash", "zsh", "tcsh")
_EXAMPLES = """examples:
  hdsp completion bash > ~/.local/share/bash-completion/completions/hdsp
  hdsp completion zsh > ~/.zfunc/_hdsp        # a folder in fpath
  hdsp completion tcsh > ~/.hdsp.tcsh && echo 'source ~/.hdsp.tcsh' >> ~/.tcshrc"""


def add_completion(commands, parser: argparse.ArgumentParser) -> None:
    """Adds the command `completion` for a parser with all commands."""
    added = commands.add_parser(
        "completion", help="print a script for shell completion", description=_script.__doc__, epilog=_EXAMPLES
    )
    added.add_argument("shell", choices=_SHELLS, help="the shell")
    added.set_defaults(run=lambda chosen: _script(chosen, parser))


def _script(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Prints a script with which the shell completes commands, options, files, robots and heuristics."""
    print(shtab.complete(parser, chosen.shell))
