"""One loader of settings: nothing is converted silently, and each fault is one line with key, value, allowed values."""

import copy
import math
import pickle
from dataclasses import asdict, field, fields, replace
from typing import Any, Literal, Self

import numpy as np
import pytest
from pydantic import model_validator

from hdsp.base.errors import InputError
from hdsp.base.settings import Count, Name, Positive, Range, Share, checked, fault, load_settings
from hdsp.base.yaml_files import parse_yaml, read_json, read_yaml


@checked
class Leg:
    length: Positive
    joints: tuple[int, ...] = (1, 2)


@checked
class Foot(Leg):
    kind: Literal["wheel", "point"] = "wheel"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.length > 2:
            raise fault("length", self.length, "at most 2")
        return self


@checked
class Walker:
    legs: tuple[Foot, ...]
    spare: Leg | None = None
    reach: Range = (0.5, 1.0)
    share: Share = 0.5
    steps: Count = 3
    fast: bool = False
    name: Name = "walker"
    parts: dict[str, Leg] = field(default_factory=dict)
    notes: dict[str, Any] = field(default_factory=dict)


def load(**values):
    return load_settings(Walker, {"legs": [{"length": 1}], **values}, "walker")


def test_whole_numbers_become_floats_and_lists_tuples_and_nothing_else_is_converted():
    walker = load(reach=[1, 2], spare={"length": 2, "joints": [3]}, notes={"tags": [1, "a"]})
    assert walker.legs == (Foot(1.0),) and isinstance(walker.legs[0].length, float)
    assert walker.reach == (1.0, 2.0) and isinstance(walker.reach[0], float)
    assert walker.spare == Leg(2.0, (3,)) and walker.notes == {"tags": [1, "a"]}
    assert load_settings(Walker, walker) is walker


def test_settings_are_frozen_dataclasses():
    leg = Leg(1.0)
    assert [entry.name for entry in fields(leg)] == ["length", "joints"] and asdict(leg) == {
        "length": 1.0,
        "joints": (1, 2),
    }
    assert replace(leg, length=2) == Leg(2.0) and hash(Leg(1.0)) == hash(leg) and copy.copy(leg) == leg
    assert pickle.loads(pickle.dumps(load())) == load()
    assert repr(leg) == "Leg(length=1.0, joints=(1, 2))"
    with pytest.raises(AttributeError):
        leg.length = 3.0
    with pytest.raises(TypeError, match="once"):
        Leg(1.0, length=2.0)


def test_constructors_follow_the_same_rules():
    assert Leg(np.float64(0.5), np.array([1, 2])) == Leg(0.5, joints=[1, 2]) == Leg(length=0.5)
    with pytest.raises(InputError, match=r"^Leg\.length is -1; need a positive number$"):
        Leg(-1)
    with pytest.raises(InputError, match=r"^Leg\.length is 'a'; need a finite number$"):
        replace(Leg(1.0), length="a")
    with pytest.raises(
        InputError, match=r"^Leg: unknown key 'lenght'; did you mean 'length'\? allowed are joints, len"
    ):
        Leg(lenght=1.0)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"share": "0.3"}, "walker.share is '0.3'; need a finite number"),
        ({"share": True}, "walker.share is True; need a finite number"),
        ({"share": math.nan}, "walker.share is nan; need a finite number"),
        ({"share": 1.5}, "walker.share is 1.5; need at most 1"),
        ({"steps": 2.5}, "walker.steps is 2.5; need a whole number"),
        ({"steps": 2.0}, "walker.steps is 2.0; need a whole number"),
        ({"steps": True}, "walker.steps is True; need a whole number"),
        ({"steps": 0}, "walker.steps is 0; need at least 1"),
        ({"fast": 1}, "walker.fast is 1; need true or false"),
        ({"name": 3}, "walker.name is 3; need a text"),
        ({"name": ""}, "walker.name is ''; need a text that is not empty"),
        ({"reach": [2, 1]}, "walker.reach is [2.0, 1.0]; need the smaller number first"),
        ({"reach": [0, 1]}, "walker.reach[0] is 0; need a positive number"),
        ({"reach": [1]}, "walker.reach[1] is missing"),
        ({"reach": [1, 2, 3]}, "walker.reach is [1, 2, 3]; need a list of at most 2"),
        ({"reach": 1}, "walker.reach is 1; need a list"),
        ({"legs": None}, "walker.legs is None; need a list"),
        ({"legs": [{"length": 1}, {"length": 3}]}, "walker.legs[1].length is 3.0; need at most 2"),
        ({"legs": [{"length": 1, "kind": "whel"}]}, "walker.legs[0].kind is 'whel'; need 'wheel' or 'point'"),
        ({"legs": [{}]}, "walker.legs[0]: key 'length' is missing"),
        ({"spare": 3}, "walker.spare is 3; need a mapping"),
        ({"spare": {"Length": 1}}, "walker.spare: unknown key 'Length'; did you mean 'length'? allowed are"),
        ({"parts": {"hip joint": {"length": 0}}}, "walker.parts['hip joint'].length is 0; need a positive number"),
        ({"parts": {4: {"length": 1}}}, "walker.parts: key 4; need a text"),
        ({4: 1}, "walker: key 4 is no text; allowed are fast, legs"),
    ],
)  # fmt: skip
def test_faults_name_path_value_and_what_is_allowed(values, says):
    with pytest.raises(InputError) as caught:
        load_settings(Walker, {"legs": [{"length": 1}], **values}, "walker")
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("values", [None, 3, "a: 1", [1], [["legs", []]]])
def test_settings_that_are_no_mapping_are_refused(values):
    with pytest.raises(InputError, match=r"^walker is .*; need a mapping$"):
        load_settings(Walker, values, "walker")


def test_a_value_that_contains_itself_is_refused():
    ring: list = []
    ring.append(ring)
    with pytest.raises(InputError, match="nested too deeply, or a part of itself"):
        load(reach=ring)


def test_long_values_are_shortened():
    with pytest.raises(InputError) as caught:
        load(share={f"key {i}": list(range(1000)) for i in range(1000)})
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: [", "f.yaml, line 1: not YAML: expected the node content"),
        ("a: 1\nb: {", "f.yaml, line 2: not YAML"),
        ("a: 1\nb:\tc: 3\n", "f.yaml, line 2: not YAML"),
        ("", "f.yaml, line 1: the file is empty"),
        ("# nothing\n", "f.yaml, line 1: the file is empty"),
        ("\n- 1\n", "f.yaml, line 2: need a mapping, got [1]"),
        ("a: 1\nb: 2\na: 3\n", "f.yaml, line 3: not YAML: key 'a' is there twice, first in line 1"),
        ("{x: 0.4, y: 1, x: 0.8}", "f.yaml, line 1: not YAML: key 'x' is there twice, first in line 1"),
        ("a:\n- {b: 1, c: {d: 2, d: 2}}\n", "f.yaml, line 2: not YAML: key 'd' is there twice, first in line 2"),
        ("a: 1\nb: 2024-13-45\n", "f.yaml, line 2: not YAML: month must be in 1..12"),
        ("a: 1\nb: \0\n", "f.yaml, line 2: not YAML: special characters"),
        ("a: !!python/object/apply:os.system [ls]", "f.yaml, line 1: not YAML: could not determine a constructor"),
        ("a: 1\n---\nb: 2\n", "f.yaml, line 2: not YAML: but found another document"),
        ("a: " + "[" * 10_000, "f.yaml: nested too deeply"),
        ("a: " + "9" * 5000, "f.yaml, line 1: not YAML: Exceeds the limit"),
    ],
)
def test_texts_that_hold_no_mapping_are_named_with_their_line(text, says):
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "f.yaml")
    assert str(caught.value).startswith(says)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("pattern", ["[{}]", "{{<<: [{}]}}"])
def test_some_lines_of_aliases_that_stand_for_millions_of_values_are_refused(pattern):
    lines = [f"a{k}: &a{k} {pattern.format(', '.join([f'*a{k - 1}'] * 9))}" for k in range(1, 10)]
    with pytest.raises(InputError, match=r"^f\.yaml, line 6: not YAML: aliases stand for more than 100,000 values$"):
        parse_yaml("\n".join(["a0: &a0 {x: 1}", *lines]), "f.yaml")


def test_aliases_within_the_limit_and_texts_of_any_size_are_read(monkeypatch):
    monkeypatch.setattr("hdsp.base.yaml_files.MOST_COPIES", 2000)
    lists = "".join(f"l{k}: [{', '.join('x' * 99)}]\n" for k in range(40))  # 4000 values
    values = parse_yaml(f"base: &base [1, 2]\nall: [{', '.join(['*base'] * 500)}]\n{lists}", "f").values
    assert len(values["all"]) == 500 and values["all"][-1] == [1, 2] and len(values) == 42


def test_a_key_of_a_merged_mapping_is_no_duplicate():
    text = "base: &base {x: 1, y: 1}\na: {b: &more {<<: *base, x: 2}}\nc: {<<: *more, y: 3}\nd: {<<: *base, x: 4}\n"
    values = parse_yaml(text, "f").values
    assert values["a"] == {"b": {"x": 2, "y": 1}} and values["c"] == {"x": 2, "y": 3} and values["d"]["x"] == 4


def test_numbers_without_a_point_are_numbers():
    assert parse_yaml("a: 1e-3\nb: -2E+2\nc: .5e1\nd: 1e\ne: '1e3'\n", "f").values == {
        "a": 1e-3, "b": -200.0, "c": 5.0, "d": "1e", "e": "1e3",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("legs:\n- length: 1\n- {length: 1,\n   kind: hoof}\n", "line 4: walker.legs[1].kind is 'hoof'"),
        ("legs:\n- length: 1\n- kind: wheel\n", "line 3: walker.legs[1]: key 'length' is missing"),
        ("name: a\n\n1: 2\nlegs: []\n", "line 3: walker: key 1 is no text"),
        ("name: a\nlegs: []\nspare:\n  lenght: 3\n", "line 4: walker.spare: unknown key 'lenght'"),
        ("legs: []\nreach: [1,\n  x]\n", "line 3: walker.reach[1] is 'x'"),
        ("name: a\n", "line 1: walker: key 'legs' is missing"),
    ],
)
def test_faults_in_a_file_are_named_with_their_line(tmp_path, text, says):
    path = tmp_path / "walker.yaml"
    path.write_text(text)
    document = read_yaml(path, "walker file")
    with pytest.raises(InputError) as caught:
        load_settings(Walker, document.values, "walker", document)
    assert str(caught.value).startswith(f"{path}, {says}")


def test_files_that_cannot_be_read_are_named(tmp_path):
    (tmp_path / "binary.yaml").write_bytes(b"a: 1\nb: \xff\xfe\n")
    for read, what, name, says in [
        (read_yaml, "robot file", "nothing.yaml", "robot file .*nothing.yaml: no such file"),
        (read_yaml, "robot file", "", "is a folder, not a file"),
        (read_yaml, "robot file", "binary.yaml", r"binary\.yaml, line 2: no text in UTF-8"),
        (read_json, "report", "binary.yaml", r"binary\.yaml, line 2: no text in UTF-8"),
    ]:
        with pytest.raises(InputError, match=says):
            read(tmp_path / name, what)


@pytest.mark.parametrize("text", ['{"a":\n 1,}', "", "[" * 100_000, "1" * 5000])
def test_texts_that_are_no_json_are_named(tmp_path, text):
    (tmp_path / "f.json").write_text(text)
    with pytest.raises(InputError, match=r"f\.json.*: not JSON: "):
        read_json(tmp_path / "f.json", "report")
