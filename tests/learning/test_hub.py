"""Abstractions on the hub: card, download and upload, against a stub of the hub on this machine."""

import base64
import hashlib
import json
import re
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import numpy as np
import pytest
import yaml
from huggingface_hub import ModelCard

import hdsp
from hdsp.base.errors import InputError
from hdsp.learning.loading import load_abstraction

COMMIT = "1" * 40


class StubHub:
    """Repositories with one commit, in memory; counts what is fetched."""

    def __init__(self):
        self.files: dict[str, dict[str, bytes]] = {}
        self.fetched: list[str] = []
        self.private: dict[str, bool] = {}

    def info(self, repository: str) -> dict:
        siblings = [{"rfilename": name, "size": len(data)} for name, data in self.files[repository].items()]
        return {"_id": "0", "id": repository, "sha": COMMIT, "siblings": siblings, "private": False, "tags": []}

    def tree(self, repository: str) -> list[dict]:
        files = self.files[repository].items()
        return [{"type": "file", "path": name, "size": len(data), "oid": digest(data)} for name, data in files]


def digest(data: bytes) -> str:
    return hashlib.sha1(data).hexdigest()


def handler(hub: StubHub) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *_):
            pass

        def answer(self, content, status=200, **headers):
            body = content if isinstance(content, bytes) else json.dumps(content).encode()
            self.send_response(status)
            for name, value in {"Content-Length": len(body), **headers}.items():
                self.send_header(name.replace("_", "-"), str(value))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(body)

        def do_GET(self):
            path = self.path.partition("?")[0]
            if match := re.fullmatch(r"/api/models/([^/]+/[^/]+)(/(revision|tree)/.*)?", path):
                if match[1] not in hub.files:
                    return self.answer({"error": "no"}, 404, X_Error_Code="RepoNotFound")
                return self.answer(hub.tree(match[1]) if match[3] == "tree" else hub.info(match[1]))
            match = re.fullmatch(r"/([^/]+/[^/]+)/resolve/[^/]+/(.*)", path)
            if not match or match[2] not in hub.files.get(match[1], {}):
                return self.answer({"error": "no"}, 404, X_Error_Code="EntryNotFound")
            content = hub.files[match[1]][match[2]]
            if self.command == "GET":
                hub.fetched.append(match[2])
            return self.answer(content, ETag=f'"{digest(content)}"', X_Repo_Commit=COMMIT)

        do_HEAD = do_GET

        def do_POST(self):
            content = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            if self.path == "/api/repos/create":
                asked = json.loads(content)
                name = f"{asked.get('organization') or 'me'}/{asked['name']}"
                hub.private[name] = asked.get("private") or asked.get("visibility") == "private"
                hub.files.setdefault(name, {})
                return self.answer({"url": f"https://huggingface.co/{name}", "name": name, "id": name})
            if self.path == "/api/validate-yaml":
                return self.answer({"errors": [], "warnings": []})
            repository = re.match(r"/api/models/([^/]+/[^/]+)/", self.path)[1]
            if "/preupload/" in self.path:
                names = [file["path"] for file in json.loads(content)["files"]]
                files = [{"path": name, "uploadMode": "regular", "shouldIgnore": False, "oid": None} for name in names]
                return self.answer({"files": files})
            for line in map(json.loads, content.splitlines()):
                if line["key"] == "file":
                    hub.files[repository][line["value"]["path"]] = base64.b64decode(line["value"]["content"])
            url = f"https://huggingface.co/{repository}/commit/{COMMIT}"
            return self.answer({"commitUrl": url, "commitOid": COMMIT, "pullRequestUrl": None, "success": True})

    return Handler


@pytest.fixture
def hub(monkeypatch, tmp_path):
    stub = StubHub()
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler(stub))
    Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv("HF_ENDPOINT", f"http://127.0.0.1:{server.server_port}")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("huggingface_hub._snapshot_download.constants.HF_HUB_CACHE", str(tmp_path / "cache"))
    yield stub
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    pytest.importorskip("matplotlib")
    import hdsp.viz.notebook_views  # noqa: F401 - registers pictures, as `import hdsp` with a planner does

    return load_abstraction("momaro").save_pretrained(tmp_path_factory.mktemp("saved") / "hdsp-momaro")


def test_the_card_has_licence_tags_metrics_and_a_picture(folder):
    card = ModelCard((folder / "README.md").read_text())
    assert card.data.license == "bsd-3-clause" and card.data.library_name == "hdsp"
    assert {"robotics", "momaro", "footprint"} <= set(card.data.tags)
    stored = json.loads((folder / "config.json").read_text())["metrics"]
    shown = {f"{result.metric_type}/{result.dataset_name}": result.metric_value for result in card.data.eval_results}
    assert shown == pytest.approx(stored, abs=1e-5) and "feasibility_accuracy/random" in shown
    assert "![" in card.text and "judged_patches.png" in card.text
    picture = (folder / "judged_patches.png").read_bytes()
    assert picture.startswith(b"\x89PNG") and 5_000 < len(picture) <= 100_000
    assert f"{stored['feasibility_accuracy/random']:.2%}" in card.text


def test_what_is_pushed_is_loaded_by_its_name_and_nothing_else_is_fetched(folder, hub):
    abstraction = load_abstraction(folder)
    address = abstraction.push_to_hub("me/hdsp-momaro", private=True)
    assert address.endswith(COMMIT) and hub.private["me/hdsp-momaro"] is True
    files = hub.files["me/hdsp-momaro"]
    assert {"config.json", "model.safetensors", "README.md", "judged_patches.png"} <= set(files)
    files["payload.py"] = files["weights.pkl"] = b"import os"
    loaded = load_abstraction("me/hdsp-momaro", "momaro")
    assert sorted(hub.fetched) == ["config.json", "model.safetensors"]
    patches, goals = np.zeros((1, 72, 72), np.float32), hdsp.robot.lattice.robot_frame_goals(0).astype(np.float32)
    for one, other in zip(loaded.predict(patches, goals), abstraction.predict(patches, goals), strict=True):
        np.testing.assert_array_equal(one, other)
    load_abstraction("me/hdsp-momaro")
    assert len(hub.fetched) == 2, "the second time they come from the cache"


def test_repositories_that_do_not_load_are_named_in_one_line(hub, monkeypatch):
    for source, words in (
        ("me/nothing", "hub repository me/nothing: does not exist, or needs a token"),
        ("me/empty", "hub repository me/empty: holds no config.json, so it is no abstraction"),
    ):
        hub.files["me/empty"] = {"README.md": b"hello"}
        with pytest.raises(InputError) as error:
            load_abstraction(source)
        assert words in str(error.value) and "no folder, and not one of those" in str(error.value)
        assert "\n" not in str(error.value)
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(InputError, match=r"hub repository me/other: no (network|answer)[^\n]*$"):
        load_abstraction("me/other")
    with pytest.raises(InputError, match="'no repository' is no repository; need user/repository"):
        load_abstraction("momaro").push_to_hub("no repository")
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(InputError, match=r"needs the package huggingface_hub: pip install 'hdsp\[hub\]'"):
        load_abstraction("me/other")


def test_the_front_matter_is_plain_yaml(folder):
    _, header, text = (folder / "README.md").read_text().split("---\n", 2)
    assert yaml.safe_load(header)["model-index"][0]["name"] == "hdsp-momaro"
    assert text.strip().startswith("# hdsp-momaro")
