import pytest

from hdsp.base import provenance as fingerprint
from hdsp.base.provenance import code_fingerprint


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with this project's name, to which tests add modules."""
    monkeypatch.setattr(fingerprint, "_ROOT", tmp_path)

    def write(name, text):
        path = tmp_path / "hdsp" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    write("base", "def f(x):\n    return x\n")
    write("user", "from hdsp.base import f\n\ndef g(x):\n    return f(x)\n")
    write("stranger", "VALUE = 1\n")
    return write


def test_it_changes_with_the_code_of_a_module_and_of_what_it_imports(package):
    before = code_fingerprint(["hdsp.user"])
    package("user", "from hdsp.base import f\n\ndef g(x):\n    return f(x) + 1\n")
    changed = code_fingerprint(["hdsp.user"])
    package("base", "def f(x):\n    return -x\n")
    assert len({before, changed, code_fingerprint(["hdsp.user"])}) == 3


def test_it_does_not_change_with_words_about_the_code_or_code_that_is_not_used(package):
    before = code_fingerprint(["hdsp.user"])
    package("base", '"""What it is."""\n\n\ndef f(x):  # identity\n    """Says it again."""\n    return (x)\n')
    package("stranger", "VALUE = 2\n")
    assert code_fingerprint(["hdsp.user"]) == before


def test_imports_inside_functions_and_of_whole_modules_count(package):
    package("user", "def g(x):\n    from hdsp import base\n    return base.f(x)\n")
    before = code_fingerprint(["hdsp.user"])
    package("base", "def f(x):\n    return 2 * x\n")
    assert code_fingerprint(["hdsp.user"]) != before


def test_labels_depend_on_the_search_and_on_terrain_but_not_on_learning(monkeypatch):
    read = []
    real = fingerprint._source
    monkeypatch.setattr(fingerprint, "_source", lambda name: read.append(name) or real(name))
    code_fingerprint(["hdsp.labels.rules", "hdsp.terrain.scenes"])
    assert {"hdsp.detailed.search.kernel", "hdsp.terrain.cost_maps", "hdsp.robot.lattice", "hdsp.robot.robot"} <= set(
        read
    )
    assert not any(name.startswith(("hdsp.learning", "hdsp.viz", "hdsp.labels.shards")) for name in read)
