"""Outputs of commands never replace an input or each other, and are looked at before the work."""

import os
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hdsp import HeightMap
from hdsp.base.errors import InputError
from hdsp.planning.cli import main
from hdsp.planning.commands.output_files import OutputFile, refuse_overwriting
from tests import ROOT

ENDS = ["--start", "0.9", "0.9", "0", "--goal", "1.6", "1.1", "0"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with inputs of every kind, also under other names; nothing may begin to work there."""
    HeightMap.flat((100, 100)).save(tmp_path / "m.npz")
    np.savetxt(tmp_path / "cloud.csv", np.zeros((10, 3)))
    for name in ("ground.png", "run.mcap", "go2w.csv"):
        (tmp_path / name).write_bytes(b"precious")
    (tmp_path / "scan.png").write_bytes((ROOT / "conf/scans/pcl_room_scan.yaml").read_bytes())
    (tmp_path / "link.npz").symlink_to("m.npz")
    os.link(tmp_path / "m.npz", tmp_path / "hard.npz")
    (tmp_path / "bag").mkdir()
    for name in ("metadata.yaml", "0.mcap"):
        (tmp_path / "bag" / name).write_bytes(b"precious")
    monkeypatch.chdir(tmp_path)
    for work in ("hdsp.terrain.height_map.HeightMap.load", "hdsp.planning.commands.map_commands.map_clouds"):
        monkeypatch.setattr(work, lambda *_, **__: pytest.fail("worked before the check"))
    return tmp_path


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("map ground.png --out o.npz --picture ground.png", "--picture ground.png: the command reads this file"),
        ("map m.npz cloud.csv --out o.npz --picture ./bag/../ground.png --scan ground.png", "reads this file"),
        ("map cloud.csv --scan scan.png --out o.npz --picture scan.png", "--picture scan.png: the command reads"),
        ("plan m.npz --motion m.npz", "--motion m.npz: the command reads this file"),
        ("plan m.npz --motion ./bag/../m.npz", "the command reads this file"),
        ("plan link.npz --motion m.npz", "--motion m.npz: the command reads this file"),
        ("plan m.npz --motion hard.npz", "--motion hard.npz: the command reads this file"),
        ("plan cloud.csv --out cloud.csv", "--out cloud.csv: the command reads this file"),
        ("plan bag --motion bag/0.mcap", "--motion bag/0.mcap: the command reads this file"),
        ("plan m.npz --robot go2w.csv --out go2w.csv", "--out go2w.csv: the command reads this file"),
        ("plan m.npz --heuristic learned:run.mcap --motion run.mcap", "the command reads this file"),
        ("plan m.npz --out a.csv --motion ./a.csv", "--motion ./a.csv: --out a.csv is at the same place"),
        ("plan m.npz --motion a.mcap --record a.mcap", "--motion a.mcap is at the same place"),
        ("plan m.npz --motion run --picture run/p.png", "--picture run/p.png: --motion run is at the same place"),
        ("drive m.npz --record m.npz", "--record m.npz: the command reads this file"),
        ("drive m.npz --truth hard.npz --record link.npz", "--record link.npz: the command reads this file"),
        ("drive m.npz --robot run.mcap --record run.mcap", "--record run.mcap: the command reads this file"),
        (f"plan m.npz --out {'x' * 300}.csv", "File name too long"),
        (f"plan m.npz --motion {'x' * 300}", "File name too long"),
        (f"map m.npz --out o.npz --picture {'x' * 250}.png", "File name too long"),
        ("map cloud.csv --out m.npz/o.npz", "cannot write m.npz/o.npz"),
    ],
)
def test_outputs_that_would_replace_a_file_are_refused_before_the_work(place, words, told, capsys):
    before = contents(place)
    words = words.split()
    assert main([*words, *(ENDS if words[0] != "map" else [])]) == 1
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1
    assert contents(place) == before


@pytest.mark.parametrize(
    "words",
    [
        "--robot go2w --motion go2w",
        "--heuristic learned:momaro --motion momaro",
        "--heuristic learned:user/repository --motion user/repository",
        "--heuristic package:ground.png --picture ground.png",
        "--robot absent --motion absent",
    ],
)
def test_names_that_are_no_files_may_be_names_of_outputs(place, words, capsys, monkeypatch):
    def load(*_, **__):
        raise InputError("the work begins")

    monkeypatch.setattr("hdsp.terrain.height_map.HeightMap.load", load)
    assert main(["plan", "m.npz", *words.split(), *ENDS]) == 1
    assert capsys.readouterr().err == "error: the work begins\n"


@given(st.lists(st.text("ab/", min_size=1, max_size=5), max_size=4))
def test_outputs_are_at_one_place_if_one_is_in_the_others_folder(paths):
    paths = [f"/absent/{path}" for path in paths]
    places = [os.path.normpath(path) for path in paths]
    together = any(os.path.commonpath(pair) in pair for pair in combinations(places, 2))
    outputs = [OutputFile("--out", path) for path in paths]
    if together:
        with pytest.raises(InputError, match="is at the same place"):
            refuse_overwriting(outputs, [])
    else:
        refuse_overwriting(outputs, [])


def test_each_of_many_outputs_is_looked_at_once(monkeypatch):
    looked, real = [], os.stat
    monkeypatch.setattr("os.stat", lambda path, **more: looked.append(path) or real(path, **more))
    names = [f"plan-{number}.csv" for number in range(300)]
    refuse_overwriting([OutputFile("--out", name) for name in names], [])
    assert looked == names


def test_numbered_outputs_are_looked_at_with_their_numbers(place, capsys):
    (place / "plan-2.csv").symlink_to("cloud.csv")
    more = [*ENDS, "--goal", "1.2", "1", "--each", "--out", "plan.csv"]
    assert main(["plan", "cloud.csv", *more]) == 1
    assert "--out plan-2.csv: the command reads this file" in capsys.readouterr().err


def test_files_of_a_scan_are_no_outputs(tmp_path, capsys, monkeypatch):
    cloud = tmp_path / "cloud.png"
    cloud.write_bytes(b"precious")
    monkeypatch.setattr("hdsp.terrain.scans.find_files", lambda *_, **__: ([cloud], ""))
    scan = str(ROOT / "conf/scans/pcl_room_scan.yaml")
    assert main(["map", "--scan", scan, "--out", str(tmp_path / "o.npz"), "--picture", str(cloud)]) == 1
    assert "the command reads this file" in capsys.readouterr().err and cloud.read_bytes() == b"precious"


def test_a_height_map_may_be_converted_in_its_place(tmp_path, capsys):
    path = str(HeightMap.flat((40, 30)).save(tmp_path / "m.npz"))
    assert main(["map", path, "--out", path]) == 0 and HeightMap.load(path).shape == (40, 30)
