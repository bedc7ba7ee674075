"""Kinds of files for the fuzz suite: how a whole one is written, how it is damaged, and how it is read."""

import gzip
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from hdsp.base.yaml_files import read_yaml
from hdsp.detailed.motion.motion import Motion
from hdsp.labels.shards import read_shard, write_shard
from hdsp.robot.robot import Robot
from hdsp.terrain.arenas import read_arena
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_formats import map_contents
from hdsp.terrain.pointcloud import read_points
from hdsp.terrain.pointcloud.depth import read_image
from hdsp.terrain.scans import load_scan
from tests import ROOT
from tests.base.mutations import edited, mutated_file
from tests.fuzz import mutations
from tests.terrain import test_damaged_maps as maps
from tests.terrain.bags import reading_here
from tests.terrain.pointcloud import test_cloud_files as clouds

Damage = Callable[[bytes, np.random.Generator], bytes]
POINTS = clouds.POINTS


class FileKind(NamedTuple):
    """A kind of file.

    Attributes:
        write: folder -> path of a whole file.
        read: path -> contents; errors other than `InputError` are faults.
        inside: damage inside of the format, applied to a half of the cases; None = only to bytes.
        exact: whether a checksum covers all contents, so that whatever is read has to equal the whole file's contents.
        share: share of the cases, relative to other kinds; slow readers get less.
    """

    write: Callable[[Path], Path]
    read: Callable[[Path], Any]
    inside: Damage | None = None
    exact: bool = False
    share: float = 1.0


def _map(kind: str, inside: Damage | None = None, exact: bool = False, share: float = 1.0) -> FileKind:
    write, options = maps.KINDS[kind]

    def read(path: Path) -> Any:
        place = path.parent if path.name == "metadata.yaml" else path
        with reading_here():
            terrain = HeightMap.load(place, **options)
        assert terrain.heights.dtype == np.float32 and terrain.heights.ndim == 2 and not np.isinf(terrain.heights).any()
        assert terrain.resolution > 0 and np.isfinite(terrain.origin).all()
        frame, place_of_cells = terrain.frame, (*map(float, terrain.origin), terrain.resolution)
        names = frame.name, frame.crs, frame.notes
        return terrain.heights.tobytes(), place_of_cells, names, frame.to_source.tobytes()

    return FileKind(write, read, inside, exact, share)


def _contents(kind: str) -> FileKind:
    def read(path: Path) -> str:
        with reading_here():
            return map_contents(path)

    return FileKind(maps.KINDS[kind][0], read, share=0.3)


def _read_cloud(path: Path) -> Any:
    points = read_points(path)
    assert points.dtype == np.float64 and points.ndim == 2 and points.shape[1] == 3 and np.isfinite(points).all()
    return points.tobytes()


def _cloud(name: str, inside: Damage | None = None, share: float = 1.0) -> FileKind:
    def write(folder: Path) -> Path:
        clouds.WRITERS[name](folder / name, POINTS)
        return folder / name

    return FileKind(write, _read_cloud, inside, share=share)


def _content(name: str, content: bytes, inside: Damage | None = None, read=_read_cloud, share: float = 1.0) -> FileKind:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return FileKind(write, read, inside, share=share)


def _text(separator: str = " ", head: str = "") -> bytes:
    return (head + "".join(separator.join(f"{v:.4f}" for v in point) + "\n" for point in POINTS[:30])).encode()


def _mesh(order: str) -> bytes:
    """A PLY mesh with lists before and behind its vertices."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    head = f"ply\nformat {name} 1.0\nelement camera 2\nproperty list uchar int hits\nelement vertex 30\n"
    head += "property float x\nproperty float y\nproperty float z\nproperty list uchar short tags\nend_header\n"
    if order == "":
        rows = "".join(f"{x:.3f} {y:.3f} {z:.3f} 2 1 2\n" for x, y, z in POINTS[:30])
        return (head + "1 4\n0\n" + rows).encode()
    i, h = order + "i4", order + "i2"
    camera = b"\1" + np.array([4], i).tobytes() + b"\0"
    rows_ = b"".join(p.astype(order + "f4").tobytes() + b"\2" + np.array([1, 2], h).tobytes() for p in POINTS[:30])
    return head.encode() + camera + rows_


def _gzip_hdf5(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "map.h5", "w") as file:
        file["origin"], file["resolution"] = (1.0, 2.0), 0.05
        file.create_dataset("heights", data=maps.HEIGHTS, chunks=(5, 4), compression="gzip", shuffle=True)
    return folder / "map.h5"


def _shard(folder: Path) -> Path:
    from tests.learning.synthetic import synthetic_tasks

    return Path(write_shard(folder / "0.h5", synthetic_tasks(2), {"labels_hash": "0" * 64}))


def _read_shard(path: Path) -> Any:
    shard = read_shard(path)
    arrays = shard.tasks.arrays()
    return [arrays[name].tobytes() for name in sorted(arrays)], sorted(shard.attributes.items())


def _motion(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        import hdsp

        plan = hdsp.Planner(HeightMap.flat((80, 60))).plan((0.8, 0.7, 0), (0.9, 0.7, 0), 2.0)
        return Path(plan.refine().save(folder / f"motion{suffix}"))

    return write


def _read_motion(path: Path) -> Any:
    Motion.load(path, HeightMap.flat((80, 60)))
    return None


def _settings(name: str, text: bytes, read: Callable[[Path], Any], share: float = 1.0) -> FileKind:
    def inside(content: bytes, random: np.random.Generator) -> bytes:
        return mutated_file(yaml.safe_load(text), content, random)

    return _content(name, text, inside, read, share)


def _read_params(path: Path) -> Any:
    from pipeline.config import read_params

    read_params(path)


def _read_arena(path: Path) -> Any:
    document = read_yaml(path, "arena")
    read_arena(document.values)


def _model(folder: Path) -> Path:
    """The configuration of a small abstraction, beside its weights."""
    import torch

    from hdsp.base.settings import load_settings
    from hdsp.learning import LearnedAbstraction, ModelSettings, Provenance, build_network
    from tests.learning.synthetic import TINY_MODEL

    torch.manual_seed(0)
    model = load_settings(ModelSettings, TINY_MODEL, "model")
    abstraction = LearnedAbstraction(build_network(model), model, Provenance.of(Robot.load("momaro"), "0123"))
    return abstraction.save_pretrained(folder / "model") / "config.json"


def _read_model(path: Path) -> Any:
    from hdsp.learning import LearnedAbstraction

    found = LearnedAbstraction.from_pretrained(path.parent)
    return found.model.to_dict(), asdict(found.provenance), found.metrics, found.edges_threshold, found.calibration


def _without_checksum(content: bytes, random: np.random.Generator) -> bytes:
    values = json.loads(content)
    return json.dumps(edited({key: value for key, value in values.items() if key != "config_sha256"}, random)).encode()


def _model_types(folder: Path) -> Path:
    path = _model(folder)
    values = json.loads(path.read_text())
    del values["config_sha256"]
    path.write_text(json.dumps(values))
    return path


def _weights(folder: Path) -> Path:
    return _model(folder).with_name("model.safetensors")


def _preset(name: str) -> bytes:
    return (ROOT / f"hdsp/robot/presets/{name}.yaml").read_bytes()


def _octree() -> bytes:
    cells = np.random.default_rng(4).integers(32760, 32775, (20, 3))
    return clouds.octree_bytes(cells, cells[:5] + 3, 0.05)


KINDS: dict[str, FileKind] = {
    "npz": _map("npz", mutations.in_archive, exact=True),
    "npy": _map("npy"),
    "h5": _map("h5", mutations.in_hdf5),
    "h5 bytes": _map("h5", exact=True),
    "h5 of others": _map("h5 of others", mutations.in_hdf5),
    "h5 gzip": FileKind(_gzip_hdf5, _map("h5 of others").read, mutations.in_hdf5),
    "tif": _map("tif"),  # damage in several places may take both checksums along
    "tif of others": _map("tif of others"),
    "asc": _map("asc"),
    "png": _map("png", mutations.in_png),
    "pgm": _map("pgm"),
    "pgm text": _map("pgm as text"),
    "bag": _map("bag", share=0.3),
    "db3": _map("db3", mutations.in_database, share=0.15),
    "db3 old": _map("db3 without definitions", mutations.in_database, share=0.15),
    "mcap": _map("mcap", share=0.3),
    "bag metadata": _map("metadata of a bag", share=0.15),
    "contents of h5": _contents("h5 of others"),
    "contents of tif": _contents("tif of others"),
    "contents of bag": _contents("bag"),
    **{f"pcd {name}": _cloud(f"{name}.pcd") for name in ("ascii", "binary", "compressed")},
    "ply": _cloud("cloud.ply"),
    "ply lists": _content("mesh.ply", _mesh("<")),
    "ply big-endian": _content("mesh.ply", _mesh(">")),
    "ply ascii": _content("mesh.ply", _mesh("")),
    "las": _cloud("cloud.las"),
    "laz": _cloud("cloud.laz", share=0.004),
    "vtk ascii": _cloud("ascii.vtk"),
    "vtk binary": _cloud("binary.vtk"),
    "obj": _cloud("cloud.obj"),
    "bt": _content("map.bt", _octree()),
    "xyz": _content("cloud.xyz", _text()),
    "csv": _content("cloud.csv", _text(",", "x,y,z\n")),
    "semicolons": _content("cloud.txt", _text(";", "# X;Y;Z\n").replace(b".", b",")),
    "utf-16": _content("cloud.txt", _text().decode().encode("utf-16")),
    "xyz.gz": _content("cloud.xyz.gz", gzip.compress(_text()), mutations.in_gzip),
    "xyz.bz2": _content("cloud.xyz.bz2", mutations.bz2.compress(_text()), mutations.in_bzip2),
    "depth png": FileKind(maps.KINDS["png"][0], lambda path: read_image(path).tobytes(), mutations.in_png),
    "shard": FileKind(_shard, _read_shard, mutations.in_hdf5, exact=False, share=0.3),
    "motion npz": FileKind(_motion(".npz"), _read_motion, mutations.in_archive, share=0.3),
    "motion json": FileKind(_motion(".json"), _read_motion, share=0.3),
    "robot": _settings("momaro.yaml", _preset("momaro"), Robot.load, share=0.2),
    "robot go2w": _settings("go2w.yaml", _preset("go2w"), Robot.load, share=0.2),
    "scan": _settings("scan.yaml", (ROOT / "conf/scans/rsl_real_stairs.yaml").read_bytes(), load_scan, share=0.3),
    "arena": _settings("arena.yaml", (ROOT / "conf/arena/paper.yaml").read_bytes(), _read_arena, share=0.3),
    "params": _settings("params.yaml", (ROOT / "params.yaml").read_bytes(), _read_params, share=0.03),
    "config.json": FileKind(_model, _read_model, exact=True, share=0.3),
    "config.json types": FileKind(_model_types, _read_model, _without_checksum, share=0.3),
    "weights": FileKind(_weights, _read_model, exact=True, share=0.3),
}
