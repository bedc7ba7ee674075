"""The counter of words in docstrings."""

import importlib.util

from tests import ROOT


def tool():
    spec = importlib.util.spec_from_file_location("docstring_words", ROOT / "tools/docstring_words.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_counts_docstrings_alone_and_fails_above_a_limit(tmp_path, capsys):
    path = tmp_path / "module.py"
    path.write_text('"""One two three."""\n\n\ndef f():\n    """Four of five."""\n    return "what of that"  # what\n')
    count = tool()
    assert count.words_of(path) == ["one", "two", "three", "four", "of", "five"]
    assert count.main([str(tmp_path)]) == 1
    assert "166.7 per 1,000 words, above the limit of 30" in capsys.readouterr().out
    path.write_text('"""Short sentences."""\n')
    assert count.main([str(tmp_path)]) == 0
