import hashlib
from dataclasses import asdict

import numpy as np
import pytest
import yaml

from hdsp.base import downloads as data_files
from hdsp.base.errors import InputError
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain.scans import Scan, build_map, find_files
from tests import ROOT
from tests.terrain.pointcloud.clouds import las_with_crs, moved, room

CONF = ROOT / "conf/scans"
NEEDED = {
    "place": "a room",
    "what": "a room",
    "sensor": "a laser",
    "licence": "MIT",
    "source": "https://example.org",
    "address": "https://example.org/data/",
}


@pytest.fixture(autouse=True)
def no_network(monkeypatch):
    def fetch(url, *_):
        raise OSError("network\nis unreachable")

    monkeypatch.setattr("hdsp.terrain.scans.fetch", fetch)
    monkeypatch.delenv(data_files.DATA_DIR_VARIABLE, raising=False)


def described(**values):
    return Scan.from_dict("room", {**NEEDED, **values})


def stored(folder, name, points):
    """Writes a cloud to its place in a data folder; returns its entry in a description."""
    path = folder / "real" / "room" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, points)
    return {"path": f"far/away/{name}", "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def test_a_scan_of_one_file_becomes_its_map(tmp_path):
    file = stored(tmp_path, "a.xyz", moved(room(), 3, 2, shift=(0, 0, 1)) * 1000)
    scan = described(files=[file], units=0.001, map={"fill": 2, "box": [-1.5, -1.0, 1.5, 1.0]})
    paths, reason = find_files(scan, tmp_path)
    assert reason == ""
    terrain = build_map(scan, paths)
    assert terrain.resolution == RESOLUTION
    assert terrain.size == pytest.approx((3, 2), abs=0.06)
    assert abs(np.nanmedian(terrain.heights)) < 0.01


def test_described_las_files_are_read_in_the_units_of_their_crs(tmp_path):
    file = {"path": "a.las", "sha256": "0" * 64}
    feet, degrees = {1024: 1, 3072: 32767, 3076: 9002}, {1024: 2, 2048: 4326}
    box = {"map": {"box": [-1.5, -1.0, 1.5, 1.0]}}
    path = las_with_crs(tmp_path / "a.las", feet, points=room() / 0.3048)
    heights = build_map(described(files=[file], **box), [path]).heights
    assert (np.abs(heights - 0.3) < 0.05).sum() * RESOLUTION**2 == pytest.approx(0.5 * 0.4, rel=0.2)
    path = las_with_crs(tmp_path / "a.las", degrees, points=room())
    with pytest.raises(InputError, match=r"scan room: point cloud .*a\.las: its CRS is in degrees; .* units"):
        build_map(described(files=[file]), [path])
    for units in (1, 0.5):  # the description has the last word
        scan = described(files=[file], units=units)
        assert build_map(scan, [path]).size == pytest.approx((4 * units, 3 * units), abs=0.06)


def test_a_second_file_is_registered_from_its_guess(tmp_path):
    whole = np.concatenate([room(seed=1), room(seed=2) * (1, 1, 0) + (0, 0, 0.8)])
    whole = whole[(whole[:, 2] < 0.5) | (np.abs(whole[:, 0]) > 1.8) | (np.abs(whole[:, 1]) > 1.3)]
    first = whole[whole[:, 0] < 1.2]
    second = moved(whole[whole[:, 0] > -1.2] - (0.5, 0.2, 0), yaw=-10)
    files = [stored(tmp_path, "a.xyz", first), {**stored(tmp_path, "b.xyz", second), "guess": [0.45, 0.25, 0.15]}]
    scan = described(files=files, level_each=True, map={"level": False})
    terrain = build_map(scan, find_files(scan, tmp_path)[0])
    assert terrain.size == pytest.approx((4, 3), abs=0.06)
    box = np.abs(terrain.heights - 0.3) < 0.05
    assert box.sum() * RESOLUTION**2 == pytest.approx(0.5 * 0.4, rel=0.2)  # and not two of them


def test_a_missing_file_is_named_with_the_way_to_get_it(tmp_path):
    scan = described(files=[{"path": "far/away/a.xyz", "sha256": "0" * 64}])
    paths, reason = find_files(scan, tmp_path)
    assert paths == []
    for words in ("scan room", str(tmp_path), "https://example.org/data/far/away/a.xyz", "HDSP_DATA_DIR", "real/room/"):
        assert words in reason
    assert "\n" not in reason
    assert "HDSP_DATA_DIR is not set" in find_files(scan)[1]


def test_a_file_that_was_changed_is_refused(tmp_path):
    scan = described(files=[stored(tmp_path, "a.xyz", room())])
    with (tmp_path / "real/room/a.xyz").open("a") as file:
        file.write("0 0 0\n")
    with pytest.raises(InputError, match=r"a\.xyz is not the file it should be"):
        find_files(scan, tmp_path)


def test_errors_of_a_scan_name_it(tmp_path):
    scan = described(files=[stored(tmp_path, "a.xyz", room() + (0, 0, 0))], map={"box": [90, 90, 91, 91]})
    paths = find_files(scan, tmp_path)[0]
    with pytest.raises(InputError, match="scan room: height map of points: none is left in the box"):
        build_map(scan, paths)
    for more in ({}, {"level_each": True}):
        with pytest.raises(InputError, match=r"scan room: a\.xyz: no point is left; look at drop_within"):
            build_map(described(files=[asdict(scan.files[0])], drop_within=99.0, **more), paths)
    with pytest.raises(InputError, match="scan room: 0 files; its description has 1"):
        build_map(scan, [])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"files": []}, r"files is \[\]; need a list of at least 1"),
        ({"files": [{"path": "a", "sha256": "b", "colour": 1}]}, r"scan room\.files\[0\]: unknown key 'colour'"),
        ({"files": [{"path": "a"}]}, r"scan room\.files\[0\]: key 'sha256' is missing"),
        ({"files": [{"path": "a", "sha256": "b"}], "licence": ""}, "licence is ''; need a text that is not empty"),
        ({"files": [{"path": "a", "sha256": "b"}], "map": {"floor": {"slope": 1}}}, r"map\.floor: unknown key 'slope'"),
        ({"files": [{"path": "a", "sha256": "b"}], "map": {"fill": -1}}, "fill is -1"),
        ({"files": [{"path": "a", "sha256": "b"}], "camera": {"fx": 1.0}}, "camera: key .* is missing"),
        ({"files": [{"path": "a", "sha256": "b"}], "height": 1}, "scan room: unknown key 'height'"),
    ],
)
def test_bad_descriptions_are_named(values, words):
    with pytest.raises(InputError, match=words):
        described(**values)


def real_scans():
    files = sorted(path for path in CONF.glob("*.yaml") if path.stem != "default")
    return {path.stem: Scan.from_dict(path.stem, yaml.safe_load(path.read_text())) for path in files}


def test_every_scan_is_listed_and_names_its_source_and_licence():
    listed = yaml.safe_load((CONF / "default.yaml").read_text())["defaults"]
    scans = real_scans()
    assert set(listed) - {"_self_"} == set(scans)
    assert len({scan.place for scan in scans.values()}) >= 5
    for scan in scans.values():
        assert scan.source.startswith("https://") and scan.address.endswith("/") and scan.licence and scan.sensor


#: Known heights (m) of the treads.
STEPS = {"plane_seg_ori_stairs": [0.16, 0.32, 0.48, 0.64]}


@pytest.mark.parametrize("name", sorted(real_scans()))
def test_real_scans_become_maps_with_the_floor_at_0(name):
    scan = real_scans()[name]
    folder = data_files.data_folder() or ROOT / "shared/data"
    paths, reason = find_files(scan, folder)
    if not paths:
        pytest.skip(reason)
    heights = build_map(scan, paths).heights
    known = heights[np.isfinite(heights)]
    near_floor = known[np.abs(known) < 0.08]
    assert abs(np.median(near_floor)) < 0.02
    assert near_floor.size > 0.1 * known.size
    assert known.max() <= scan.map.highest
    for step in STEPS.get(name, []):
        assert (np.abs(known - step) < 0.03).mean() > 0.02


@pytest.mark.parametrize("path", ["../a.xyz", "/etc/passwd", "b/../../a.xyz", "..\\a.xyz", ""])
def test_files_of_a_scan_never_leave_its_folder(path):
    with pytest.raises(InputError, match=r"files\[0\]\.(path|local) is "):
        described(files=[{"path": path, "sha256": "0" * 64}])
    with pytest.raises(InputError, match=r"files\[0\]\.(path|local) is "):
        described(files=[{"path": "a.xyz", "sha256": "0" * 64, "local": path or ".."}])


@pytest.mark.parametrize("name", ["../room", "a/b", "..", ""])
def test_a_scan_is_named_like_a_file(name):
    with pytest.raises(InputError, match="name is "):
        Scan.from_dict(name, {**NEEDED, "files": [{"path": "a.xyz", "sha256": "0" * 64}]})
