"""`hdsp view` and `hdsp demo` on the command line."""

import signal
import subprocess
import sys

import numpy as np
import pytest

from hdsp import HeightMap
from hdsp.planning.cli import NO_PLAN, main
from hdsp.planning.viewing import map_viewer
from tests import heed_interrupts

QUICK = ["--heuristic", "geometric", "--port", "0", "--quiet"]


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    heights = np.zeros((120, 120), np.float32)
    heights[56:64, :60] = 1.0
    return str(HeightMap(heights).save(tmp_path_factory.mktemp("map") / "room.npz"))


def test_a_page_instead_of_a_server(map_file, tmp_path, capsys):
    page = tmp_path / "plan.html"
    ends = ["--start", "0.8", "0.8", "0", "--goal", "0.8", "2", "free"]
    assert main(["view", map_file, *ends, "--page", str(page), *QUICK]) == 0
    assert "solved: drives" in capsys.readouterr().out
    assert "__VISER_EMBED_DATA__" in page.read_text()
    ends = ["--start", "0.8", "0.8", "0", "--goal", "1.5", "1", "0"]
    assert main(["view", map_file, *ends, "--page", str(page), *QUICK]) == NO_PLAN
    assert "the robot cannot stand at the goal: the body would hit" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--robot", "nobody"], "unknown robot"),
        (["--port", "70000"], "0 to 65535"),
        (["--page", "plan.png"], ".html"),
        (["--goal", "1", "north"], "need X Y DEGREES"),
        (["--weight", "0.5"], "weight is 0.5; it must be a finite number >= 1"),
        (["--tolerance", "-1"], "tolerance is -1.0; it must be a finite number >= 0"),
        (["--tolerance", "nan"], "tolerance is nan"),
        (["--margin", "-0.1"], "margin is -0.1"),
        (["--start", "nan", "1", "0"], "start [nan, 1.0, 0.0]: need finite numbers"),
        (["--goal", "1", "1", "inf"], "goal [1.0, 1.0, inf]: need finite numbers"),
        (["--heuristic", "best", "--page", "plan.html"], "need 'geometric'"),
    ],
)
def test_wrong_options_give_one_line(map_file, options, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["view", map_file, *QUICK, *options]) == 1
    heard = capsys.readouterr().err.strip()
    assert words in heard and heard.count("\n") == 0


def test_a_viewer_that_cannot_be_built_leaves_no_server(map_file, monkeypatch):
    closed = []
    monkeypatch.setattr(map_viewer, "close_server", closed.append)
    monkeypatch.setattr(map_viewer, "open_server", lambda port: "server")
    monkeypatch.setattr(map_viewer, "PlanScene", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["view", map_file, *QUICK])
    assert closed == ["server"]


def test_ctrl_c_ends_quietly(map_file):
    command = [sys.executable, "-m", "hdsp", "view", map_file, "--no-browser", *QUICK]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, preexec_fn=heed_interrupts) as running:
        assert running.stdout.readline().startswith("http://127.0.0.1:")
        assert running.stdout.readline().startswith("solved")
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=60)
    assert (running.returncode, out.strip()) == (0, "")
    assert "Traceback" not in err
