"""Values in notebooks: pages with a small picture, and the plain representation without Matplotlib."""

import base64
import io
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from hdsp import HeightMap, Planner
from hdsp.terrain.map_frame import MapFrame
from tests import ROOT
from tests.labels.task_sets import random_tasks


@pytest.fixture(scope="module")
def shown():
    """Values of each kind that has a page, by name."""
    heights = np.zeros((120, 100), np.float32)
    heights[60:64] = 1.0
    heights[:9, :9] = np.nan
    terrain = HeightMap(heights, frame=MapFrame("<odom>", notes=("levelled by 3 & 4 degrees",)))
    planner = Planner(terrain, conditioning=None)
    plan = planner.plan((0.8, 1.2, 0), (0.9, 1.2, 0))
    noise = np.random.default_rng(0).random((900, 900))
    return {
        "map": terrain,
        "noise": HeightMap(noise),
        "nothing known": HeightMap(np.full((9, 9), np.nan)),
        "plan": plan,
        "no plan": planner.plan((0.8, 1.2, 0), (2.4, 1.2, 0)),
        "invalid start": planner.plan((1.5, 1.2, 0), (0.8, 1.2, 0)),
        "motion": plan.refine(),
        "tasks": random_tasks(30),
        "no tasks": random_tasks(0),
    }


NAMES = "map", "noise", "nothing known", "plan", "no plan", "invalid start", "motion", "tasks", "no tasks"


class Cells(HTMLParser):
    """Texts of the page, and its tags that are still open at the end."""

    def __init__(self, page):
        super().__init__()
        self.texts, self.open = [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if tag != "img":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_a_small_picture_and_a_table(shown, name):
    from PIL import Image

    page, picture = shown[name]._repr_html_(), shown[name]._repr_png_()
    assert len(picture) <= 100_000
    pixels = Image.open(io.BytesIO(picture)).convert("L")
    assert min(pixels.size) >= 120 and np.asarray(pixels).std() > 3
    assert base64.b64decode(re.search('base64,([^"]*)', page)[1]) == picture
    cells = Cells(page)
    assert cells.open == [] and len(cells.texts) >= 6


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("map", ["3.00 × 2.50 m", "120 × 100, 0.025 m", "0.7%", "<odom>", "levelled by 3 & 4 degrees"]),
        ("plan", ["solved", "geometric, W = 1", "momaro"]),
        ("no plan", ["infeasible", "No plan"]),
        ("motion", ["momaro", "Motion"]),
        ("tasks", ["30", "660", "Labelled tasks"]),
    ],
)
def test_the_table_has_the_main_figures(shown, name, words):
    texts = Cells(shown[name]._repr_html_()).texts
    assert [word for word in words if word not in texts] == []
    if name == "no plan":
        assert any("an edge of 100 cm" in text for text in texts) and "limits" not in shown[name].__dict__


def test_a_picture_is_drawn_once(shown, monkeypatch):
    picture = shown["map"]._repr_png_()
    monkeypatch.setattr("hdsp.viz.notebook_views.small_png", lambda _: pytest.fail("drawn again"))
    assert shown["map"]._repr_png_() is picture


def test_without_matplotlib_the_plain_representation_stays():
    script = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "import hdsp; terrain = hdsp.HeightMap.flat((40, 40))\n"
        "print(terrain._repr_html_(), terrain._repr_png_(), repr(terrain)[:9])"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["None", "None", "HeightMap"]
