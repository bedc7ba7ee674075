"""The viewer in a browser, as a user sees it: a drag, a new plan, a failure, a motion, and a page without a server."""

import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from hdsp import HeightMap
from hdsp.planning.viewing.map_viewer import MapViewer
from hdsp.planning.viewing.planning_session import PlanningRequest

CHROMIUM = shutil.which("chromium")
playwright = pytest.importorskip("playwright.sync_api", reason="the browser is driven by playwright")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium: apt-get install chromium"),
    pytest.mark.xdist_group("browser"),
]

#: WebGL in software, nothing from the network.
FLAGS = [
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-default-apps",
    "--no-first-run", "--mute-audio",
]  # fmt: skip
#: Software renders slowly, and kernels may be compiled first.
PATIENCE = 120
WIDTH, HEIGHT = 800, 420
START, GOAL, ON_WALL = (0.8, 0.8, 0.0), (2.2, 2.2, 0.0), (1.5, 1.0, 0.0)
#: Messages of the browser that say nothing about the page.
HARMLESS = "favicon", "GPU stall", "THREE.Clock", "swiftshader", "software WebGL"


def room():
    """3 x 3 m with a wall across the lower half, and unknown cells in a corner."""
    heights = np.zeros((120, 120), np.float32)
    heights[56:64, :60] = 0.5
    heights[-12:, :12] = np.nan
    return HeightMap(heights)


@pytest.fixture(scope="module")
def chromium():
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS, headless=True)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def viewer():
    shown = MapViewer(room(), PlanningRequest(START, GOAL), port=8970)
    assert shown.session.wait(PATIENCE)
    # The handles lie beside the panel.
    shown.server.initial_camera.position, shown.server.initial_camera.look_at = (2.1, -1.2, 3.6), (2.1, 1.3, 0.0)
    yield shown
    shown.close()


class Tab:
    """A tab of the browser that collects its errors."""

    def __init__(self, browser, address):
        self.page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        self.page.set_default_timeout(PATIENCE * 1000)
        self.errors = []
        self.page.on("console", self._note)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(address)
        self.page.wait_for_selector("canvas")

    def _note(self, message):
        if message.type == "error" and not any(word in message.text for word in HARMLESS):
            self.errors.append(message.text)

    def shows(self, words):
        self.page.wait_for_function("words => document.body.innerText.includes(words)", arg=words, polling=200)
        return True


@pytest.fixture(scope="module")
def tab(chromium, viewer):
    opened = Tab(chromium, viewer.address)
    until(lambda: viewer.server.get_clients())
    opened.shows("cost")
    yield opened
    opened.page.close()


@pytest.fixture(autouse=True)
def no_errors(request):
    yield
    if "tab" in request.fixturenames:
        assert request.getfixturevalue("tab").errors == []


def until(true):
    end = time.monotonic() + PATIENCE
    while not (found := true()):
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)
    return found


def in_picture(viewer, point):
    """Pixel of a point in the first browser."""
    (camera,) = [client.camera for client in viewer.server.get_clients().values()][:1]
    w, x, y, z = camera.wxyz
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    right, down, ahead = (np.asarray(point, float) - camera.position) @ turn
    focal = camera.image_height / 2 / np.tan(camera.fov / 2)
    return camera.image_width / 2 + focal * right / ahead, camera.image_height / 2 + focal * down / ahead


def drag(tab, viewer, handle, way):
    """Drags the square of a handle, which moves it in x and y, with the mouse."""
    x, y, heading = handle.pose()
    aside = 0.255 * 0.7 * np.sqrt(2)  # middle of the square, from the handle, at 45 degrees to its axes
    grip = np.array([x + aside * np.cos(heading + np.pi / 4), y + aside * np.sin(heading + np.pi / 4), 0.0])
    mouse = tab.page.mouse
    mouse.move(*in_picture(viewer, grip))
    mouse.down()
    for share in np.linspace(0.2, 1.0, 5):
        mouse.move(*in_picture(viewer, grip + share * np.array([*way, 0.0])))
    mouse.up()


def test_a_dragged_goal_gets_a_new_plan(tab, viewer):
    before = viewer.answer
    tab.shows(f"{before.plan.cost:.3f}")
    end = time.monotonic() + PATIENCE
    while viewer.session.request is before.request:  # a scene that is not yet drawn has no handles
        assert time.monotonic() < end, "the handle cannot be dragged"
        drag(tab, viewer, viewer.goal, (0.0, -1.0))
        time.sleep(3.0)
    until(lambda: viewer.answer.request is not before.request)
    answer = viewer.answer
    assert answer.plan.solved
    assert answer.request.start == START
    assert answer.request.goal == pytest.approx((2.2, 1.2, 0.0), abs=0.15)
    # The handle lies on the lattice, where the plan ends.
    until(lambda: viewer.goal.pose()[:2] == pytest.approx(tuple(answer.plan.states[-1, :2])))
    assert viewer.session.wait(PATIENCE)
    tab.shows(f"{viewer.answer.plan.cost:.3f}")


def test_the_motion_plays_and_pauses(tab, viewer):
    assert viewer.session.wait(PATIENCE) and viewer.motion is not None
    viewer.jump(0.0)
    first = viewer.scene.body.placed[0].copy()  # position and quaternion of the base
    tab.page.get_by_role("button", name="Play").click()
    tab.page.get_by_role("button", name="Pause").wait_for()
    until(lambda: np.linalg.norm(viewer.scene.body.placed[0] - first) > 0.02)
    assert viewer.playback.time > 0
    tab.page.get_by_role("button", name="Pause").click()
    until(lambda: not viewer.playback.playing)
    stopped = viewer.playback.time
    assert viewer.panel.time.value == pytest.approx(stopped, abs=0.01)
    viewer.playback.speed = 1000.0
    tab.page.get_by_role("button", name="Play").click()
    until(lambda: viewer.playback.time == viewer.playback.line.duration)
    tab.page.get_by_role("button", name="Play").wait_for()
    viewer.playback.speed = 1.0


def test_a_failure_names_its_cause_at_its_place(tab, viewer):
    viewer.change(goal=ON_WALL)
    until(lambda: viewer.answer.request.goal == ON_WALL and viewer.explained.is_set())
    assert not viewer.answer.plan.solved
    tab.shows("The robot cannot stand at the goal")
    tab.shows("the body would hit the ground that rises to 0.50 m")
    assert viewer.server.scene.get_handle_by_name("/failure/cause_1") is not None
    viewer.change(goal=GOAL)
    until(lambda: viewer.answer.request.goal == GOAL)
    assert viewer.server.scene.get_handle_by_name("/failure/cause_1") is None


def test_controls_and_layers(tab, viewer):
    tab.page.get_by_label("foot costs").click()
    until(lambda: viewer.server.scene.get_handle_by_name("/layers/foot costs"))
    tab.page.get_by_label("unknown ground").click()
    until(lambda: not viewer.scene.unknown.visible)
    tab.page.get_by_label("foot costs").click()
    until(lambda: viewer.server.scene.get_handle_by_name("/layers/foot costs") is None)


def test_two_browsers_share_a_viewer_that_outlives_them(chromium, viewer, tab):
    other = Tab(chromium, viewer.address)
    until(lambda: len(viewer.server.get_clients()) == 2)
    viewer.change(weight=1.5)
    until(lambda: viewer.answer.request.weight == 1.5)
    assert viewer.session.wait(PATIENCE)
    assert other.shows(f"{viewer.answer.plan.cost:.3f}") and tab.shows(f"{viewer.answer.plan.cost:.3f}")
    other.page.close()
    until(lambda: len(viewer.server.get_clients()) == 1)
    viewer.change(weight=1.25)
    until(lambda: viewer.answer.request.weight == 1.25)
    assert other.errors == []


def test_the_button_saves_the_plan_as_a_page(tab, viewer):
    assert viewer.session.wait(PATIENCE)
    with tab.page.expect_download() as coming:
        tab.page.get_by_role("button", name="Save as page").click()
    assert coming.value.suggested_filename == "plan.html"
    text = Path(coming.value.path()).read_text(encoding="utf-8")
    assert "window.__VISER_EMBED_DATA__=" in text and text.rstrip().endswith("</html>")


def test_a_page_shows_the_plan_without_a_server(chromium, viewer, tmp_path):
    opened = Tab(chromium, viewer.save_page(tmp_path / "plan.html").as_uri())
    opened.page.locator("input").first.wait_for()  # time and speed of the playback
    assert opened.errors == []
    opened.page.close()
