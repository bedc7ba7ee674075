"""Parts that all commands share: JSON, progress, interrupts, errors of usage, shell completion."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.base.progress_line import ProgressLine
from hdsp.planning.cli import NO_PLAN, command_parser, main
from hdsp.planning.commands.console import plain
from hdsp.robot.robot import Robot
from tests import ROOT, heed_interrupts

ENDS = "--start", "0.9", "0.9", "0", "--goal", "1.6", "1.1", "-20"


@pytest.fixture
def ground(tmp_path):
    """Map files: flat ground, and a wall across it."""
    HeightMap.flat((100, 100)).save(tmp_path / "flat.npz")
    wall = np.zeros((150, 100), np.float32)
    wall[70:74] = 1.0
    HeightMap(wall).save(tmp_path / "wall.npz")
    return tmp_path


def document(capsys):
    """The only JSON document on standard output; no number in it is NaN or infinite."""
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    return json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_a_plan_as_json_is_the_plan_of_the_library(ground, capsys):
    status = main(["plan", str(ground / "flat.npz"), *ENDS, "--heuristic", "geometric", "--json", "--out",
                   str(ground / "p.csv")])  # fmt: skip
    found = document(capsys)
    plan = Planner(ground / "flat.npz").plan((0.9, 0.9, 0), (1.6, 1.1, np.deg2rad(-20)), 1.25)
    assert status == 0 and found["status"] == "solved" and found["solved"]
    np.testing.assert_allclose(found["states"], plan.states)
    assert found["cost"] == pytest.approx(plan.cost) and found["bound"] == pytest.approx(plan.bound)
    assert found["actions"] == [str(action) for action in plan.actions]
    assert found["words"] == plan.explain() and found["stats"]["expansions"] == plan.stats.expansions
    assert found["map"]["shape"] == [100, 100] and found["files"] == {"out": str(ground / "p.csv")}


def test_a_failure_as_json_names_causes_with_places_and_the_nearest_pose(ground, capsys):
    ends = "--start", "0.9", "1.1", "0", "--goal", "2.8", "1.1", "0"
    assert main(["plan", str(ground / "wall.npz"), *ends, "--heuristic", "geometric", "--json"]) == NO_PLAN
    found = document(capsys)
    assert found["status"] == "infeasible" and found["cost"] is None and found["states"] == []
    (cause, *_) = found["causes"]
    assert cause["kind"] == "edge" and 1.7 < cause["place"][0] < 1.9 and "an edge of 100 cm" in cause["words"]
    assert len(found["nearest"]["pose"]) == 7 and found["nearest"]["distance"] > 0.5
    assert main(["plan", str(ground / "wall.npz"), "--start", "1.8", "1.1", "0", *ends[4:], "--json"]) == NO_PLAN
    found = document(capsys)
    assert found["status"] == "invalid_start" and found["problems"] and found["stats"]["lower_bound"] == 0


def test_bad_input_as_json_is_a_document_too(ground, capsys):
    assert main(["plan", str(ground / "none.npz"), *ENDS, "--json"]) == 1
    assert document(capsys) == {"status": "error", "error": f"height map {ground / 'none.npz'}: no such file"}


def test_maps_and_contents_as_json(ground, capsys):
    assert main(["map", str(ground / "wall.npz"), "--out", str(ground / "o.tif"), "--json"]) == 0
    found = document(capsys)
    assert found["map"]["highest"] == 1.0 and found["map"]["known"] == 1.0 and found["files"]["out"].endswith("o.tif")
    np.savetxt(ground / "p.xyz", np.random.default_rng(0).random((500, 3)) * (4, 4, 0.01))
    for name, kind in (("wall.npz", "height map"), ("o.tif", "height map"), ("p.xyz", "point cloud")):
        assert main(["info", str(ground / name), "--json"]) == 0
        assert document(capsys)["kind"] == kind


def test_robots_abstractions_scans_and_arenas_are_described(tmp_path, capsys):
    assert main(["info", "momaro", "--json"]) == 0
    found = document(capsys)
    assert found["kind"] == "robot" and found["abstractions"] == ["momaro", "momaro-klamt2019"]
    assert Robot.load(found["values"]) == Robot.load("momaro")
    for name in ("hdsp/robot/presets/momaro.yaml", "conf/scans/pcl_room_scan.yaml", "conf/arena/paper.yaml"):
        assert main(["info", str(ROOT / name)]) == 0
    told = capsys.readouterr().out
    assert "wheels: pass edges of 0.05 m" in told
    assert "scan pcl_room_scan: office" in told and "arena of 10 x 10 m" in told
    assert main(["info", str(ROOT / "hdsp/learning/shipped/momaro")]) == 0
    assert "trained abstraction for momaro" in capsys.readouterr().out
    assert main(["info", "walker"]) == 1
    assert "none of the robots and abstractions anymal_wheels, go2w, momaro" in capsys.readouterr().err


def test_values_that_json_lacks_become_null_or_lists():
    values = {"a": np.inf, "b": np.float32(1.5), "c": (np.nan, np.arange(2)), "d": Robot.load("momaro").name, "e": None}
    assert plain(values) == {"a": None, "b": 1.5, "c": [None, [0, 1]], "d": "momaro", "e": None}


def test_names_that_a_terminal_cannot_show_are_escaped(ground, monkeypatch):
    """Letters beyond ASCII, and a name of bytes that are no UTF-8; JSON has the name itself."""
    for name in ("r3ü.npz", os.fsdecode(b"r\xfc.npz")):
        for encoding in ("ascii", "utf-8"):
            screen = io.TextIOWrapper(io.BytesIO(), encoding)
            monkeypatch.setattr(sys, "stdout", screen)
            path, picture = str(ground / name), str(ground / "p.png")
            assert main(["map", str(ground / "flat.npz"), "--out", path, "--quiet"]) == 0
            assert main(["map", path, "--out", str(ground / "o.npz"), "--picture", picture, "--json", "--quiet"]) == 0
            assert main(["info", path, "--json", "--quiet"]) == 0
            told, _, _, found = screen.buffer.getvalue().decode(encoding).splitlines()
            assert json.loads(found)["file"] == path
            assert name in told or name.encode("ascii", "backslashreplace").decode() in told


@pytest.mark.parametrize(
    "words", [["info", "none.npz"], ["info", "none.npz", "--json"], ["--help"], ["completion", "zsh"]]
)
def test_a_reader_that_has_gone_ends_a_command_quietly(words, monkeypatch, capfd):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert main(words) == 1
    told = capfd.readouterr().err
    assert "Error" not in told and told.count("\n") <= 1


def test_an_error_of_the_system_is_one_line(ground, capsys, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied", "closed/m.npz")

    monkeypatch.setattr(HeightMap, "load", refuse)
    assert main(["plan", "m.npz", *ENDS, "--json", "--quiet"]) == 1
    told = capsys.readouterr()
    assert told.err == "error: closed/m.npz: Permission denied\n" and json.loads(told.out)["status"] == "error"
    for words, where in ((["completion", "bash"], ""), (["--help"], "standard output: ")):
        with open("/dev/full", "w") as full:
            monkeypatch.setattr(sys, "stdout", full)
            assert main(words) == 1
        assert capsys.readouterr().err == f"error: {where}No space left on device\n"


@pytest.mark.parametrize("name", ["x" * 300, "x" * 300 + ".pcd", "x" * 300 + ".npz", "x" * 300 + ".yaml"])
def test_a_name_that_is_too_long_is_no_traceback(name, capsys):
    assert main(["info", name]) == 1
    told = capsys.readouterr().err
    assert told.startswith("error: ") and "File name too long" in told and told.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["plan", "m.npz", *ENDS, "--wieght", "2"], "unknown option --wieght; did you mean --weight"),
        (["info", "m.npz", "--zzz"], "unknown option --zzz; allowed are --help, --json, --units"),
        (["info", "m.npz", "other"], "unexpected argument 'other'"),
        (["plan", "m.npz", *ENDS, "--weight", "fast"], "--weight: 'fast' is no number"),
        (["plan", "m.npz", *ENDS, "--expansions", "1.5"], "--expansions: '1.5' is no whole number"),
        (["plan", "m.npz", "--start", "-5e-05", "1", "-e", *ENDS[4:]], "--start: expected 3 arguments"),
        (["completion", "fishy"], "choose from"),
        (["nothing"], "choose from"),
    ],
)
def test_wrong_usage_names_what_is_allowed(words, told, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert told in error and error.count("\n") <= 2


def test_negative_numbers_in_any_notation_are_values():
    words = "-5e-05", "-1.", "-.5E+2", "-1_0", "-inf"
    parse = command_parser().parse_args
    found = parse(["plan", "m.npz", "--start", *words[:3], "--goal", *words[:3]])
    assert found.start == [-5e-5, -1.0, -50.0] and found.goal == [list(words[:3])]
    found = parse(["map", "c.xyz", "--out", "m.npz", "--box", *words[:4], "--lowest", words[4], "--origin", *words[:2]])
    assert found.box == [*map(float, words[:4])] and found.lowest == -np.inf and found.origin == [-5e-5, -1.0]


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["--improve", "3", "--time", "4"], "leave out --time"),
        (["--improve", "3", "--each"], "leave out --each"),
        (["--memory", "0"], "--memory is 0; need a positive number of GiB"),
        (["--robot", "walker"], "presets are anymal_wheels, go2w, momaro"),
        (["--heuristic", "best"], "need 'geometric', 'grid', 'manual', 'learned'"),
    ],
)
def test_wrong_values_name_what_is_allowed(ground, more, told, capsys):
    assert main(["plan", str(ground / "flat.npz"), *ENDS, *more, "--quiet"]) == 1
    error = capsys.readouterr().err
    assert told in error and error.count("\n") == 1


def test_a_plan_to_each_goal_and_limits_of_the_search(ground, capsys):
    more = ["--goal", "1.2", "1.0", "--each", "--heuristic", "geometric", "--out", str(ground / "p.csv")]
    assert main(["plan", str(ground / "flat.npz"), *ENDS, *more]) == 0
    told = capsys.readouterr().out
    assert "goal 1 of 2: 1.6 1.1 -20" in told and "goal 2 of 2: 1.2 1.0" in told
    assert (ground / "p-1.csv").is_file() and (ground / "p-2.csv").is_file() and not (ground / "p.csv").exists()
    assert main(["plan", str(ground / "flat.npz"), *ENDS, "--expansions", "1", "--heuristic", "geometric"]) == NO_PLAN
    assert "not decided: stopped after 1 expansion" in capsys.readouterr().out


def test_better_and_better_plans_are_told_with_cost_and_bound(ground, capsys):
    wanted = ["plan", str(ground / "flat.npz"), *ENDS, "--heuristic", "geometric", "--improve", "20"]
    assert main(wanted) == 0
    told = re.findall(r"s: cost ([\d.]+), at most ([\d.]+) times", capsys.readouterr().out)
    assert told and told[-1][1] == "1.00"
    assert main([*wanted, "--json"]) == 0
    found = document(capsys)
    costs = [each["cost"] for each in found["improvements"]]
    assert costs == sorted(costs, reverse=True) and found["cost"] == costs[-1] and found["stats"]["ended"] == "solved"


def test_an_interrupt_keeps_the_best_plan(ground, capsys, monkeypatch):
    def plans(planner, *_, **__):
        yield Planner(ground / "flat.npz").plan((0.9, 0.9, 0), (1.6, 1.1, 0), 2.0)
        raise KeyboardInterrupt

    monkeypatch.setattr(Planner, "improve", plans)
    out = ground / "p.csv"
    assert main(["plan", str(ground / "flat.npz"), *ENDS, "--improve", "9", "--out", str(out), "--quiet"]) == 0
    told = capsys.readouterr()
    assert out.is_file() and "end of the improvement: interrupted" in told.out
    assert told.err == "interrupted: the best plan so far is kept\n"


def test_ctrl_c_ends_a_command_with_one_line_and_no_file(tmp_path):
    script = (
        "import sys, time\nfrom hdsp.planning import cli\nfrom hdsp.terrain.height_map import HeightMap\n"
        "HeightMap.load = lambda *_, **__: print('ready', flush=True) or time.sleep(60)\n"
        "sys.exit(cli.main(sys.argv[1:]))\n"
    )
    command = [sys.executable, "-c", script, "plan", "m.npz", *ENDS, "--out", "p.csv"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    running = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=heed_interrupts,
    )  # fmt: skip
    assert running.stdout.readline() == "ready\n"
    running.send_signal(signal.SIGINT)
    _, error = running.communicate(timeout=30)
    assert running.returncode == 130 and error.splitlines()[-1] == "interrupted"
    assert "Traceback" not in error and list(tmp_path.iterdir()) == []


class Terminal(io.StringIO):
    def __init__(self, terminal):
        super().__init__()
        self._terminal = terminal

    def isatty(self):
        return self._terminal


@pytest.mark.parametrize("terminal", [True, False])
def test_progress_is_one_line_on_a_terminal_and_a_line_now_and_then_elsewhere(terminal, monkeypatch):
    for name in ("_SILENT", "_ON_TERMINAL", "_ELSEWHERE"):
        monkeypatch.setattr(f"hdsp.base.progress_line.{name}", 0.01)
    stream = Terminal(terminal)
    line = ProgressLine(stream)
    with line.during("searching"):
        line.detail("7 states expanded")
        limit = time.monotonic() + 20
        while stream.getvalue().count("7 states expanded, 0 s") < 2 and time.monotonic() < limit:
            time.sleep(0.01)
        line.say("a warning")
    lines = stream.getvalue().split("\n")
    if terminal:
        assert lines[0].count("\r") >= 2 and lines[0].endswith("\r\x1b[Ka warning")
    else:
        assert lines[:2] == ["searching: 7 states expanded, 0 s"] * 2 and "a warning" in lines
    quiet = ProgressLine(Terminal(terminal), quiet=True)
    with quiet.during("searching"):
        time.sleep(0.05)
    assert quiet.stream.getvalue() == ""


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_a_shell_gets_a_script_with_commands_options_and_names(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "improve" in script and "completion" in script
    if shell != "tcsh":
        assert "anymal_wheels go2w momaro" in script and "geometric grid manual learned" in script


def test_bash_completes_robots_options_and_files(ground, capsys):
    main(["completion", "bash"])
    script = capsys.readouterr().out

    def completed(*words):
        wanted = f"{script}\nCOMP_WORDS=(hdsp {' '.join(words)}); COMP_CWORD={len(words)}; _shtab_hdsp\n"
        done = subprocess.run(
            ["bash", "-c", wanted + 'printf "%s\\n" "${COMPREPLY[@]}"'], cwd=ground, capture_output=True, text=True
        )
        return done.stdout.split()

    assert completed("plan", "--robot", "mo") == ["momaro"]
    assert completed("plan", "--heur") == ["--heuristic"]
    assert completed("plan", "wa") == ["wall.npz"]


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0 and re.fullmatch(r"hdsp (\d+\.\d+\.\d+|unknown.*)\n", capsys.readouterr().out)


def test_help_fits_80_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    parser = command_parser()
    commands = next(action for action in parser._actions if action.choices).choices
    for each in (parser, *commands.values()):
        assert [line for line in each.format_help().splitlines() if len(line) > 80] == []
        assert [action.dest for action in each._actions if not action.help and not action.choices] == []


@pytest.mark.parametrize("command", ["plan", "drive", "map", "info"])
def test_the_page_on_the_command_line_lists_the_options_of_the_parser(command):
    page = (ROOT / "docs/command-line.md").read_text()
    listed = re.search(rf"Options of `hdsp {command}`: (.*?)\.\n\n", page, re.S)[1]
    commands = next(action for action in command_parser()._actions if action.choices).choices
    allowed = {name for action in commands[command]._actions for name in action.option_strings}
    assert {*re.findall(r"`(--[\w-]+)`", listed)} == {name for name in allowed if name.startswith("--")} - {"--help"}
    assert all(f"`hdsp {name}" in page for name in commands)


def test_the_page_on_the_command_line_names_the_fields_of_the_documents(ground, capsys):
    main(["plan", str(ground / "wall.npz"), "--start", "1.8", "1.1", "0", "--goal", "2.8", "1.1", "0", "--json"])
    found = document(capsys)
    page = (ROOT / "docs/command-line.md").read_text()
    assert [name for name in [*found, *found["map"]] if f"`{name}`" not in page] == []
