"""The README's examples work."""

import re

from tests import ROOT


def test_the_library_example_runs(tmp_path, monkeypatch, capsys):
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    learned = 'heuristic="learned"'
    assert learned in example
    monkeypatch.chdir(tmp_path)
    exec(example.replace(learned, 'heuristic="manual"'), {})  # in seconds
    assert capsys.readouterr().out.startswith("solved")
    assert (tmp_path / "path.png").read_bytes().startswith(b"\x89PNG")


def test_every_link_to_a_file_of_the_project_leads_somewhere():
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        for target in re.findall(r"\]\((?!http)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
