"""Pictures of the viewer for docs/viewer.md: a plan up stairs, foot costs, and a failure, as a browser shows them.

    python -m examples.viewer_pictures [--out docs/figures] [--chromium /usr/bin/chromium]

Needs `pip install 'hdsp[view]' playwright` and Chromium. The browser renders without a GPU.
"""

from __future__ import annotations

import argparse
import io
import shutil
import time
from pathlib import Path

from hdsp.base.files import replacing
from hdsp.planning.viewing.map_viewer import MapViewer
from hdsp.planning.viewing.planning_session import PlanningRequest
from hdsp.terrain import random_arena

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
START, GOAL, OFF = (1.0, 3.0, 0.0), (4.25, 0.75, None), (2.45, 1.5, 0.0)
WIDTH, HEIGHT = 1200, 720
SECONDS = 900  # of patience


def main(argv=None) -> list[Path]:
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/figures"))
    parser.add_argument("--chromium", default=shutil.which("chromium"))
    arguments = parser.parse_args(argv)

    viewer = MapViewer(random_arena(7), PlanningRequest(START, GOAL), port=0)
    made = []
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=arguments.chromium, args=FLAGS)
            page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            page.set_default_timeout(1000 * SECONDS)
            page.goto(viewer.address)
            page.wait_for_selector("canvas")
            assert viewer.session.wait(SECONDS)
            viewer.jump(0.7 * viewer.playback.line.duration)
            made.append(picture(page, arguments.out / "viewer_plan.png"))
            viewer.show_layer("foot costs", True)
            made.append(picture(page, arguments.out / "viewer_layers.png"))
            viewer.show_layer("foot costs", False)
            viewer.change(goal=OFF)
            assert viewer.session.wait(SECONDS) and viewer.explained.wait(SECONDS)
            made.append(picture(page, arguments.out / "viewer_failure.png"))
            browser.close()
    finally:
        viewer.close()
    for path in made:
        print(path)
    return made


def picture(page, path: Path) -> Path:
    """Takes a picture after the scene has settled, with few colours, so that the file is small."""
    from PIL import Image

    time.sleep(8)
    close = page.get_by_role("alert").get_by_role("button")
    if close.count():
        close.first.click()
        time.sleep(2)
    taken = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    with replacing(path) as temporary:
        taken.quantize(200, dither=Image.Dither.NONE).save(temporary, format="png", optimize=True)
    return path


if __name__ == "__main__":
    main()
