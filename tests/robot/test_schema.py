"""The robot file's schema and its documentation page agree with the classes."""

import json
import re
import subprocess
import sys

import pytest
import yaml

from hdsp.robot.robot import Robot
from hdsp.robot.schema import PAGE_FILE, SCHEMA_FILE, keys, main, page, robot_schema
from tests import ROOT

SCHEMA = robot_schema()


@pytest.mark.parametrize("name", [SCHEMA_FILE, PAGE_FILE])
def test_the_files_in_docs_are_those_of_the_classes(name, tmp_path):
    main([str(tmp_path)])
    written = (tmp_path / name).read_text(encoding="utf-8")
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == written, "run `python -m hdsp.robot.schema docs`"


def flat(values, path=""):
    if isinstance(values, dict):
        return {found for key, value in values.items() for found in flat(value, f"{path}.{key}" if path else key)}
    return flat(values[0], f"{path}[]") if isinstance(values, list) else {path}


def test_the_schema_has_all_keys_of_a_robot_file():
    values = yaml.safe_load((ROOT / "hdsp/robot/presets/momaro.yaml").read_text())
    optional = {key.path for key in keys(SCHEMA) if "default" in key.schema}
    assert flat(values) - optional == {key.path for key in keys(SCHEMA)} - optional
    assert {"drive.sideways", "drive.wheel_radius"} <= optional and "drive.max_height_difference" in flat(values)


def test_each_key_has_its_meaning_its_unit_and_its_range():
    found = {key.path: key.schema for key in keys(SCHEMA)}
    assert all(schema["description"][0].islower() for schema in found.values())
    assert found["step.max_length"] == {
        "type": "number", "minimum": 0, "maximum": 0.375, "unit": "m",
        "description": "largest distance between the two footholds; 0 = the robot does not step. [m]",
    }  # fmt: skip
    assert found["body.boxes[].above"]["exclusiveMinimum"] == 0
    assert "| `turn.unevenness_cost` " in page(SCHEMA) and re.search(r"\| 1/m +\| ≥ 0", page(SCHEMA))


def test_an_editor_refuses_what_the_loader_refuses():
    """Unknown and missing keys, as far as a schema can express them."""
    parts = [SCHEMA, *SCHEMA["$defs"].values()]
    assert all(part["additionalProperties"] is False for part in parts)
    for part in parts:
        assert part.get("required", []) == [key for key, value in part["properties"].items() if "default" not in value]
    assert len(parts) == 16 and set(SCHEMA["properties"]) == set(Robot.load("momaro").to_dict())


def test_the_command_prints_the_schema():
    done = subprocess.run([sys.executable, "-m", "hdsp.robot.schema"], cwd=ROOT, capture_output=True, check=True)
    assert json.loads(done.stdout) == SCHEMA
